"""What packages of the project say: one version, one list of requirements, one licence."""

import re
import tomllib
from pathlib import Path
from typing import Any

import yaml

import spl_batch

ROOT = Path(__file__).parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]
CONDA = {
    "dask[distributed]": ("dask-core", "distributed"),
    "laspy[lazrs]": ("laspy", "lazrs-python"),
    "matplotlib": ("matplotlib-base",),
}
"""What packages are called there, where that differs."""


def loaded(name: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))
    return found


def test_version_and_licence_are_the_same_everywhere() -> None:
    citation, recipe = loaded("CITATION.cff"), loaded("conda/recipe.yaml")
    assert citation["version"] == recipe["package"]["version"] == spl_batch.__version__
    assert citation["license"] == recipe["about"]["license"] == PROJECT["license"]


def test_the_conda_recipe_has_the_requirements_of_the_project() -> None:
    expected = {"python": PROJECT["requires-python"]}
    for text in PROJECT["dependencies"]:
        name, version = re.fullmatch(r"([^<>=]+)(>=.+)", text).groups()  # type: ignore[union-attr]
        expected |= dict.fromkeys(CONDA.get(name, (name,)), version)
    expected["lazrs-python"] = ""  # laspy asks for any
    listed = (
        f"{line} ".split(" ", 1) for line in loaded("conda/recipe.yaml")["requirements"]["run"]
    )
    assert {name: version.strip() for name, version in listed} == expected


def test_the_default_has_what_the_extras_of_results_name() -> None:
    extras = PROJECT["optional-dependencies"]
    for name in ("report", "altimetry", "geiger"):
        assert set(extras[name]) <= set(PROJECT["dependencies"]), name


def test_the_image_has_no_rights_and_copies_what_the_build_needs() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert re.search(r"^USER (?!root)", text, re.MULTILINE)
    sent = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    copied = {
        name for line in re.findall(r"^COPY (.+)", text, re.MULTILINE) for name in line.split()[:-1]
    }
    assert {f"!{name}" for name in copied} <= set(sent)

"""What packages of the project declare: one version, one list of requirements, one licence."""

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


def test_the_changelog_has_the_version_and_groups_what_users_notice() -> None:
    lines = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()
    versions = [line for line in lines if line.startswith("## ")]
    assert versions[0].startswith(f"## [{spl_batch.__version__}] - ")
    groups = [line.removeprefix("### ") for line in lines if line.startswith("### ")]
    assert {"Added", "Changed", "Fixed"} <= set(groups)
    assert set(groups) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert len(groups) <= 6 * len(versions)


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


def test_the_conda_recipe_builds_and_starts_what_the_project_does() -> None:
    recipe = loaded("conda/recipe.yaml")
    scripts = [f"{name} = {entry}" for name, entry in PROJECT["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == scripts
    (backend,) = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    assert backend.replace(">=", " >=") in recipe["requirements"]["host"]
    assert f"python {PROJECT['requires-python']}" in recipe["requirements"]["host"]
    assert recipe["schema_version"] == 1
    assert (ROOT / "conda" / recipe["source"]["path"]).resolve() == ROOT
    assert (ROOT / recipe["about"]["license_file"]).is_file()


def test_the_citation_has_what_its_format_asks_for() -> None:
    citation = loaded("CITATION.cff")
    assert citation["cff-version"] == "1.2.0"
    assert citation["message"]
    assert citation["title"] == "spl_batch"
    for work in (citation, *citation["references"]):
        assert work["title"]
        assert all("name" in one or "family-names" in one for one in work["authors"])
    assert all({"type", "title", "authors"} <= set(work) for work in citation["references"])

"""The image: which Python it has, who runs in it, what is copied, what it starts."""

import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def instructions() -> list[tuple[str, str]]:
    """Every instruction of the Dockerfile, continued lines joined."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    lines = re.sub(r"^#.*\n", "", text, flags=re.MULTILINE).replace("\\\n", " ").splitlines()
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in lines) if word]


def all_of(word: str) -> list[str]:
    return [rest for found, rest in instructions() if found == word]


def last_stage() -> list[tuple[str, str]]:
    found = instructions()
    start = max(k for k, (word, _) in enumerate(found) if word == "FROM")
    return found[start:]


def test_every_stage_has_a_python_that_the_project_supports() -> None:
    images = [line.split()[0] for line in all_of("FROM")]
    assert len(set(images)) == 1, "wheels are built for the Python that runs them"
    version = re.fullmatch(r"python:(3\.\d+)-slim", images[0])
    assert version, images
    assert f"Programming Language :: Python :: {version[1]}" in PROJECT["classifiers"]


def test_the_user_has_no_rights_from_before_the_command_on() -> None:
    (user,) = [rest for word, rest in last_stage() if word == "USER"]
    assert user not in {"root", "0"}
    assert any(re.search(rf"useradd .*\b{user}\b", line) for line in all_of("RUN"))
    after = [word for word, _ in last_stage()]
    after = after[after.index("USER") + 1 :]
    assert "RUN" not in after
    assert "COPY" not in after
    settings = dict(one.split("=", 1) for line in all_of("ENV") for one in shlex.split(line))
    cache = settings["NUMBA_CACHE_DIR"]
    assert any(f"--mode 1777 {cache}" in line for line in all_of("RUN")), "any user may compile"
    for name in ("HOME", "MPLCONFIGDIR"):
        assert settings[name].startswith("/tmp"), "a user without a home may write"  # noqa: S108


def test_it_starts_a_command_of_the_project() -> None:
    (entry,) = map(json.loads, all_of("ENTRYPOINT"))
    assert len(entry) == 1
    assert entry[0] in PROJECT["scripts"]
    assert list(map(json.loads, all_of("CMD"))) == [["--help"]]


def test_what_the_build_copies_is_there_and_is_sent() -> None:
    copied = {name for line in all_of("COPY") for name in line.split()[:-1]}
    assert all((ROOT / name).exists() for name in copied)
    sent = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    assert {f"!{name}" for name in copied} <= set(sent)
    needed = {"pyproject.toml", PROJECT["readme"], *PROJECT["license-files"], "spl_batch"}
    assert needed <= copied

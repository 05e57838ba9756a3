"""A wheel in an environment of its own: every command works without the clone.

Machine code is kept under the paths of its sources, which are new here, so a user's cache has none of it: one run
compiles what a run needs, without the passes that would make it fast, into a cache that goes with the environment. The
measurement after it compiles nothing.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Callable
from email.message import Message
from email.parser import Parser
from pathlib import Path

import pytest
import yaml

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("hapsim", "firmware_protocol")
SCENE = """\
version: 1
rate: 1000
device: {mass: 0.2, friction: 1.0, clock: lockstep}
mock: {initial: {velocity: 0.1}}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 1000, damping: 5}
"""


def call(*command: object, **options: object) -> str:
    """What a program printed that did as asked."""
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, timeout=300, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return str(done.stdout)


def pip(*words: object) -> None:
    """Without a network."""
    call(sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *words)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy, so that nothing of an earlier build gets into it and nothing is left in the clone."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in (*PACKAGES, "configs"):
        shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "MANIFEST.in", "README.md"):
        shutil.copy(REPOSITORY / name, folder)
    pip("wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder / "dist", folder)
    (built,) = (folder / "dist").glob("hapsim-*.whl")
    return built


@pytest.fixture(scope="module")
def contents(wheel: Path) -> dict[str, str]:
    """Every file of the wheel by its name, without the directory of its data's place."""
    with zipfile.ZipFile(wheel) as opened:
        return {
            name.partition(".data/data/")[2] or name: opened.read(name).decode("utf-8") for name in opened.namelist()
        }


@pytest.fixture(scope="module")
def hapsim(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """Calls the installed `hapsim …` from a folder with a scene in it."""
    environment, folder = tmp_path_factory.mktemp("environment"), tmp_path_factory.mktemp("elsewhere")
    venv.create(environment, with_pip=False, symlinks=True)
    pip("--python", environment / "bin" / "python", "install", "--no-deps", "--no-index", "--no-compile", wheel)
    (packages,) = environment.glob("lib/python*/site-packages")
    # What hapsim depends on; a clone that is installed there as editable is not found by way of this line.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    (folder / "scene.yaml").write_text(SCENE, encoding="utf-8")
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    variables |= {"XDG_CACHE_HOME": str(environment / "cache"), "NUMBA_OPT": "0", "COLUMNS": "200"}

    def run(*words: object, program: tuple[str, ...] = ("hapsim",)) -> str:
        name, *options = program
        return call(environment / "bin" / name, *options, *words, cwd=folder, env=variables)

    assert str(environment) in run("-c", "import hapsim; print(hapsim.__file__)", program=("python",))
    return run


def test_everything_that_the_clone_has_is_in_the_wheel(contents: dict[str, str]) -> None:
    found = [path for package in PACKAGES for path in (REPOSITORY / package).rglob("*") if path.is_file()]
    ours = [path for path in found if "__pycache__" not in path.parts]
    assert {path.suffix for path in ours} == {
        ".py",
        ".md",
        ".json",
        ".yaml",
        ".h",
        ".c",
        ".ld",
        ".service",
        ".typed",
        "",
    }
    for path in ours:
        assert contents[path.relative_to(REPOSITORY).as_posix()] == path.read_text(encoding="utf-8")
    for path in (REPOSITORY / "configs").rglob("*.yaml"):
        assert contents[f"share/hapsim/{path.relative_to(REPOSITORY).as_posix()}"] == path.read_text(encoding="utf-8")


def test_nothing_else_is(contents: dict[str, str]) -> None:
    assert {name.split("/")[0] for name in contents if ".dist-info/" not in name} == {*PACKAGES, "share"}


def test_it_tells_what_it_is(contents: dict[str, str]) -> None:
    (text,) = (text for name, text in contents.items() if name.endswith(".dist-info/METADATA"))
    metadata: Message = Parser().parsestr(text)
    assert metadata["Name"] == "hapsim"
    assert metadata["Keywords"]
    assert "Typing :: Typed" in metadata.get_all("Classifier", [])
    assert metadata["Requires-Python"] == ">=3.11"
    assert metadata.get_payload() == (REPOSITORY / "README.md").read_text(encoding="utf-8")


def test_its_version_is_the_one_that_hapsim_tells(hapsim: Callable[..., str], wheel: Path) -> None:
    told = hapsim("--version").splitlines()
    assert told[0] == f"hapsim {wheel.name.split('-')[1]}"
    assert "hapsim" in hapsim("--help", program=("python", "-m", "hapsim"))


def test_what_compiles_nothing_works_from_it(hapsim: Callable[..., str]) -> None:
    assert yaml.safe_load(hapsim("schema"))["title"] == "hapsim scene, version 1"
    hapsim("ports", "--json")
    hapsim("new", "first.yaml")
    assert "stable" in hapsim("check", "first.yaml")
    assert "Picture: plane.svg" in hapsim("chart", "plane", "first.yaml", "--picture", "plane.svg")


def test_a_scene_runs_and_is_measured_from_it(hapsim: Callable[..., str]) -> None:
    assert yaml.safe_load(hapsim("run", "scene.yaml", "--duration", 0.1, "--json"))["ticks"] == 100
    measured = yaml.safe_load(hapsim("measure", "scene.yaml", "--json"))
    assert measured["measured"]["k"] == pytest.approx(measured["predicted"]["k"], rel=1e-5)


def test_a_wheel_in_a_folder_finds_its_scenes_too(wheel: Path, tmp_path: Path) -> None:
    """As `pip install --target` leaves it."""
    pip("install", "--no-deps", "--no-index", "--no-compile", "--target", tmp_path / "there", wheel)
    variables = os.environ | {"PYTHONPATH": str(tmp_path / "there")}
    call(sys.executable, "-m", "hapsim", "new", "scene.yaml", cwd=tmp_path, env=variables)
    assert (tmp_path / "scene.yaml").read_text(encoding="utf-8") == (
        REPOSITORY / "configs" / "first_touch.yaml"
    ).read_text(encoding="utf-8")

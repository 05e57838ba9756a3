"""A wheel in an environment of its own: every command works without the clone.

Machine code is kept under the paths of its sources, which are new here, so a user's cache has none of it: this is the
one compilation of a run from nothing, without the passes that would make it fast, as on a new machine.
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
from typing import Any

import pytest
import yaml

REPOSITORY = Path(__file__).resolve().parents[2]
CONFIGS = REPOSITORY / "configs"
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


BUILD = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"


def call(*command: object, **options: object) -> subprocess.CompletedProcess[str]:
    """A program that did as asked."""
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, timeout=300, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done  # type: ignore[no-any-return]


def pip(*words: object) -> None:
    """Runs pip without a network."""
    call(sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *words)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The archive of the sources. It is built from a copy, so that nothing of an earlier build gets into it and nothing
    is left in the clone."""
    folder = tmp_path_factory.mktemp("archive")
    for name in (*PACKAGES, "configs", "tests", "tools", ".ci"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(REPOSITORY / name, folder / "copy" / name, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE", "MANIFEST.in"):
        shutil.copy(REPOSITORY / name, folder / "copy")
    call(sys.executable, "-c", BUILD, folder, cwd=folder / "copy")
    (built,) = folder.glob("hapsim-*.tar.gz")
    return built


@pytest.fixture(scope="module")
def unpacked(archive: Path) -> Path:
    shutil.unpack_archive(archive, archive.parent / "unpacked", filter="data")
    (folder,) = (archive.parent / "unpacked").iterdir()
    return folder


@pytest.fixture(scope="module")
def wheel(unpacked: Path) -> Path:
    """Built from the archive, as pip builds what an index has no wheel of."""
    pip("wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", unpacked.parent, unpacked)
    (built,) = unpacked.parent.glob("hapsim-*.whl")
    return built


@pytest.fixture(scope="module")
def contents(wheel: Path) -> dict[str, str]:
    """Every file of the wheel by its name."""
    with zipfile.ZipFile(wheel) as opened:
        return {name: opened.read(name).decode("utf-8") for name in opened.namelist()}


@pytest.fixture(scope="module")
def hapsim(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
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

    def run(*words: object, program: tuple[str, ...] = ("hapsim",)) -> subprocess.CompletedProcess[str]:
        name, *options = program
        return call(environment / "bin" / name, *options, *words, cwd=folder, env=variables)

    assert str(environment) in run("-c", "import hapsim; print(hapsim.__file__)", program=("python",)).stdout
    return run


def files_of(folder: Path, *names: str) -> dict[str, bytes]:
    """The content of every file below these directories, by its name in `folder`."""
    found = [path for name in names for path in (folder / name).rglob("*") if path.is_file()]
    ours = [path for path in found if "__pycache__" not in path.parts]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in ours}


def test_the_wheel_has_every_file_of_the_packages_and_nothing_else(contents: dict[str, str]) -> None:
    ours = files_of(REPOSITORY, *PACKAGES)
    scenes = {f"hapsim/{name}": text for name, text in files_of(REPOSITORY, "configs").items()}
    kinds = {".py", ".md", ".json", ".yaml", ".h", ".c", ".ld", ".service", ".typed"}
    assert {Path(name).suffix for name in ours} >= kinds
    assert len(scenes) > 14
    (manual,) = (name for name in contents if name.endswith(".data/data/share/man/man1/hapsim.1"))
    manuals = {manual: ours["hapsim/hapsim.1"]}
    found = {name: text.encode() for name, text in contents.items() if ".dist-info/" not in name}
    assert found == ours | scenes | manuals


def test_the_archive_has_every_file_of_the_clone(unpacked: Path) -> None:
    names = (*PACKAGES, "configs", "tests", "tools")
    assert files_of(unpacked, *names).items() >= files_of(REPOSITORY, *names).items()
    for name in ("README.md", "CHANGELOG.md", "LICENSE", "pyproject.toml", ".ci/run"):
        assert (unpacked / name).read_text("utf-8") == (REPOSITORY / name).read_text("utf-8")


def test_the_metadata_describes_the_package(contents: dict[str, str]) -> None:
    (text,) = (text for name, text in contents.items() if name.endswith(".dist-info/METADATA"))
    metadata: Message = Parser().parsestr(text)
    assert metadata["Name"] == "hapsim"
    assert metadata["Keywords"]
    assert "Typing :: Typed" in metadata.get_all("Classifier", [])
    assert metadata["Requires-Python"] == ">=3.11"
    assert metadata["License-Expression"] == "MIT"
    assert metadata["Author"] == "the hapsim authors"
    page = (REPOSITORY / "hapsim" / "PACKAGE.md").read_text(encoding="utf-8")
    assert metadata.get_payload() == page
    assert "](" not in page  # a link or a picture of a clone leads nowhere on an index's page


def test_its_version_is_the_one_that_hapsim_prints(hapsim: Callable[..., Any], wheel: Path) -> None:
    told = hapsim("--version").stdout.splitlines()
    assert told[0] == f"hapsim {wheel.name.split('-')[1]}"
    assert "hapsim" in hapsim("--help", program=("python", "-m", "hapsim")).stdout


@pytest.mark.thorough
def test_what_compiles_nothing_works_from_it(hapsim: Callable[..., Any]) -> None:
    assert yaml.safe_load(hapsim("schema").stdout)["title"] == "hapsim scene, version 1"
    hapsim("new", "first.yaml")
    assert "stable" in hapsim("check", "wall").stdout
    assert yaml.safe_load(hapsim("scenes", "--json").stdout).keys() == {path.stem for path in CONFIGS.glob("*.yaml")}
    for path in yaml.safe_load(hapsim("files", "--json").stdout).values():
        assert Path(path).exists()
    assert "Picture: plane.svg" in hapsim("chart", "plane", "first.yaml", "--picture", "plane.svg").stdout


AFTERWARDS = """
from hapsim.running.compile_ahead import UNITS, main
print([name for name in ("loop", "port", "loopback", "mock", "portable") if UNITS[name].is_kept()])
main(["loopback"])
"""


@pytest.mark.thorough
def test_what_two_processes_compile_for_a_run_is_kept_and_the_scene_is_measured(hapsim: Callable[..., Any]) -> None:
    ran = hapsim("run", "scene.yaml", "--duration", 0.1, "--json")
    assert yaml.safe_load(ran.stdout)["ticks"] == 100
    assert "compiling" in ran.stderr
    kept = hapsim("-c", AFTERWARDS, program=("python",)).stdout
    assert kept == "['loop', 'loopback']\n"  # and a second process compiles nothing any more
    measured = yaml.safe_load(hapsim("measure", "scene.yaml", "--json").stdout)
    assert measured["measured"]["k"] == pytest.approx(measured["predicted"]["k"], rel=1e-5)


COMMANDS = """
import sys
from hapsim import cli
for words in (["new", "--from", "wall", "scene.yaml"], ["faults", "--list"], ["scenes"]):
    sys.argv = ["hapsim", *words]
    try:
        cli.main()
    except SystemExit as end:
        assert not end.code, words
"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    "layout", [("--target", "there"), ("--prefix", "there"), ("--user",)], ids=lambda words: words[0]
)
def test_every_layout_finds_its_scenes(wheel: Path, tmp_path: Path, layout: tuple[str, ...]) -> None:
    """A wheel finds its scenes in a directory, below a distribution's prefix, and in a user's home."""
    variables = os.environ | {"PYTHONUSERBASE": str(tmp_path / "there"), "PIP_BREAK_SYSTEM_PACKAGES": "1"}
    words = ["install", "--no-deps", "--no-index", "--no-compile", "--no-warn-script-location", "--ignore-installed"]
    base = Path(sys.base_prefix) / "bin" / "python3"
    call(base, "-m", "pip", "--quiet", *words, *layout, wheel, cwd=tmp_path, env=variables)
    (packages,) = {path.parent.parent for path in (tmp_path / "there").rglob("hapsim/__init__.py")}
    variables["PYTHONPATH"] = f"{packages}{os.pathsep}{sysconfig.get_path('purelib')}"
    call(sys.executable, "-c", COMMANDS, cwd=tmp_path, env=variables)
    written, shipped = tmp_path / "scene.yaml", REPOSITORY / "configs" / "wall.yaml"
    assert written.read_text(encoding="utf-8") == shipped.read_text(encoding="utf-8")

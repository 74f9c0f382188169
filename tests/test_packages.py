"""Public names of the packages, and warnings about files of the user that hide a package."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import dynamics
import evaluation
import mpc
import shield
from dynamics.packages import hiding_file
from evaluation.commands import cli

ROOT = Path(__file__).parents[1]
ENVIRONMENT = """
import gymnasium as gym
from highway_env.envs.highway_env import HighwayEnvFast
gym.register("InTheFolder-v0", entry_point=HighwayEnvFast, kwargs={"config": {"duration": 2, "vehicles_count": 1}})
"""


def run(folder, script, *options):
    """Run a user's script in its folder, with this project further back on the path."""
    (folder / "mine.py").write_text(script, encoding="utf-8")
    environment = {"PYTHONPATH": str(ROOT), "PATH": ""}
    return subprocess.run(
        [sys.executable, *options, "mine.py"], cwd=folder, capture_output=True, text=True, env=environment
    )


@pytest.mark.parametrize("package", [shield, evaluation, mpc], ids=lambda package: package.__name__)
def test_dir_lists_the_public_names(package):
    listed = dir(package)
    assert set(package.__all__) <= set(listed)
    assert "__version__" in listed
    assert package.__version__ == dynamics.__version__
    for name in listed:
        assert getattr(package, name) is not None


def test_the_lowest_package_has_the_version():
    assert dynamics.__version__.count(".") == 2


def test_the_citation_names_this_version():
    assert f"\nversion: {dynamics.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_python_m_shield_is_the_command():
    done = subprocess.run([sys.executable, "-m", "shield", "--version"], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == f"highway-shield {shield.__version__}\n", done.stderr


@pytest.mark.parametrize(
    ("hidden", "imported"),
    [
        ("dynamics.py", "from shield import ShieldedEnv"),
        ("dynamics.py", "from mpc import MPCPolicy"),
        ("dynamics.py", "from evaluation.policies import load_reference"),
        ("mpc.py", "import shield"),
        ("mpc/__init__.py", "import evaluation"),
        ("shield/__init__.py", "from evaluation.policies import load_reference"),
    ],
)
def test_a_users_file_that_hides_a_package_is_named_at_import(tmp_path, hidden, imported):
    file = tmp_path / hidden
    file.parent.mkdir(exist_ok=True)
    file.write_text("", encoding="utf-8")
    done = run(tmp_path, imported)
    assert done.returncode == 1
    last, package = done.stderr.strip().splitlines()[-1], file.relative_to(tmp_path).parts[0].removesuffix(".py")
    assert last.startswith(f"ImportError: {file} hides the package {package!r} of highway-shield"), done.stderr


def test_the_named_remedy_works(tmp_path):
    (tmp_path / "renamed.py").write_text("", encoding="utf-8")
    assert run(tmp_path, "import renamed\nfrom shield.errors import ShieldError").returncode == 0


def test_a_users_evaluation_is_warned_of_and_works(tmp_path):
    """The shield needs none, and the user may want none: `import shield` warns, and goes on."""
    (tmp_path / "evaluation.py").write_text("mine = 1\n", encoding="utf-8")
    done = run(tmp_path, "import shield, evaluation\nprint(evaluation.mine, shield.ShieldError.__name__)")
    assert done.stdout == "1 ShieldError\n"
    assert f"UserWarning: {tmp_path / 'evaluation.py'} hides the package 'evaluation' of highway-shield" in done.stderr
    assert "mine.py:1" in done.stderr


def test_a_module_of_the_users_that_was_imported_before_is_named_as_well(tmp_path):
    (tmp_path / "mpc.py").write_text("", encoding="utf-8")
    done = run(tmp_path, "import sys, mpc\nsys.path.pop(0)\nimport shield")
    assert f"ImportError: {tmp_path / 'mpc.py'} hides the package 'mpc'" in done.stderr


def test_the_projects_own_packages_hide_nothing():
    assert [hiding_file(name) for name in ("dynamics", "mpc", "shield", "evaluation")] == [None] * 4


def test_the_working_directory_is_importable_for_env_id(tmp_path, monkeypatch, capsys):
    """A console script does not have it on its path."""
    (tmp_path / "in_the_folder.py").write_text(ENVIRONMENT, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(ROOT), *(each for each in sys.path if each)])
    words = "evaluate --env-id in_the_folder:InTheFolder-v0 --policy idle --shield none --episodes 1 --jobs 1"
    monkeypatch.setattr(sys, "argv", ["shield", *words.split()])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code in (None, 0), capsys.readouterr().err
    assert "in_the_folder:InTheFolder-v0" in capsys.readouterr().out
    assert sys.path[-1] == str(tmp_path)


def test_a_file_of_the_working_directory_hides_no_installed_module(tmp_path, monkeypatch):
    (tmp_path / "numpy.py").write_text("raise RuntimeError", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [each for each in sys.path if each])
    monkeypatch.setattr(sys, "argv", ["shield", "--version"])
    with pytest.raises(SystemExit):
        cli.main()
    assert importlib.util.find_spec("numpy").origin != str(tmp_path / "numpy.py")


def test_packages_that_tests_are_skipped_without_are_in_the_extra_dev():
    """`make install` installs each package without which a test of the default suite is skipped. Tests that need Ray
    have a marker and a command of their own."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    installed = {re.split(r"[^\w-]", each)[0] for each in extras["dev"]}
    brings = {
        "griffe": "mkdocstrings-python",
        "material": "mkdocs-material",
        "mkdocstrings_handlers": "mkdocstrings-python",
    }
    asked = set()
    for path in (ROOT / "tests").rglob("test_*.py"):
        source = path.read_text(encoding="utf-8")
        asked |= set(re.findall(r'importorskip\("(\w+)', source))
        for packages in re.findall(r"for package in \((.*?)\):\n +pytest.importorskip\(package", source):
            asked |= {name.split(".")[0] for name in re.findall(r'"([\w.]+)"', packages)}
    assert {"minari", "selenium", "mkdocs"} <= asked
    assert {brings.get(name, name) for name in asked} - installed == set()

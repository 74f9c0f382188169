"""Episodes of a run are found by their row, driven again identically, and refused if that is impossible."""

from __future__ import annotations

import json
import sys

import gymnasium as gym
import pytest
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.report.table import read_episodes
from shield.errors import ConfigError

RUN = CliRunner()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two episodes without a shield, and the same two with one."""
    path = tmp_path_factory.mktemp("run") / "mine.parquet"
    options = ["--setting", "highway-fast", "--policy", "faster", "--episodes", "2", "--jobs", "1"]
    assert RUN.invoke(app, ["evaluate", *options, "--output", str(path)]).exit_code == 0
    return path


def test_a_row_of_a_table_becomes_a_page(run):
    """The page beside the table has the episode of that row: its seed and its results, to the bit."""
    result = RUN.invoke(app, ["replay", str(run), "--episode", "3"])
    assert result.exit_code == 0, result.output
    page = (run.parent / "mine-episode-3.html").read_text(encoding="utf-8")
    about = json.loads(page.split('type="application/json">')[1].split("</script>")[0])["about"]
    row = read_episodes(run).to_dict("records")[3]
    for name in ("seed", "return", "steps", "overridden", "crashed", "min_margin", "min_gap"):
        assert about[name] == row[name]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--episode", "0"], "driven without a shield; with one were 2 to 3"),
        (["--episode", "4"], "has the episodes 0 to 3, not 4"),
        ([], "have --episode"),
        (["--episode", "2", "--setting", "merge"], "a run says itself"),
        (["--episode", "2", "--policy", "idle"], "was driven by faster, not by idle"),
        (["--episode", "2", "--html", "page.pdf"], "written as .html"),
    ],
)
def test_an_episode_that_cannot_be_replayed_is_refused_at_once(run, options, said):
    """Each error message names the valid choice."""
    error = RUN.invoke(app, ["replay", str(run), *options]).exception
    assert isinstance(error, ConfigError)
    assert said in str(error)


def test_a_seed_has_no_row_and_no_file_no_run():
    """`--episode` without a run, and a run that is not there."""
    error = RUN.invoke(app, ["replay", "5", "--episode", "1"]).exception
    assert isinstance(error, ConfigError)
    assert "--episode goes with a run" in str(error)
    error = RUN.invoke(app, ["replay", "missing.parquet", "--episode", "1"]).exception
    assert isinstance(error, ConfigError)
    assert "there is no run missing.parquet" in str(error)


def test_an_episode_that_differs_from_its_row_is_reported(run, tmp_path, monkeypatch):
    """If the replayed episode differs from its row, the command says so and exits with 1."""
    from evaluation.running.records import EpisodeRecord

    row = EpisodeRecord.row
    monkeypatch.setattr(EpisodeRecord, "row", lambda self: {**row(self), "return": 0.0})
    result = RUN.invoke(app, ["replay", str(run), "--episode", "2", "--html", str(tmp_path / "page.html")])
    assert result.exit_code == 1


def test_an_episode_of_a_certificate_is_found_in_its_folder(tmp_path):
    """A folder of `shield certify` records what was driven; the episode is that of its table."""
    options = ["--setting", "highway-fast", "--policy", "faster", "--episodes", "2", "--jobs", "1", "--seed", "60"]
    assert RUN.invoke(app, ["certify", str(tmp_path), *options]).exit_code == 0
    result = RUN.invoke(app, ["replay", str(tmp_path), "--episode", "1"])
    assert result.exit_code == 0, result.output
    page = (tmp_path / "episodes-episode-1.html").read_text(encoding="utf-8")
    assert '"seed":61,' in page


OWN = """
import gymnasium as gym
from highway_env.envs.highway_env import HighwayEnvFast


class Short(HighwayEnvFast):
    @classmethod
    def default_config(cls):
        return {**super().default_config(), "duration": 3, "vehicles_count": 5}


gym.register("Short-v0", entry_point=Short)
"""


@pytest.fixture
def own_run(tmp_path, monkeypatch):
    """A run in an environment that a module of the working directory registers, which nothing has imported since."""

    def forget():
        gym.registry.pop("Short-v0", None)
        sys.modules.pop("short_road", None)

    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "short_road.py").write_text(OWN, encoding="utf-8")
    options = ["--env-id", "short_road:Short-v0", "--policy", "faster", "--episodes", "1", "--jobs", "1"]
    assert RUN.invoke(app, ["evaluate", *options, "--output", "mine.parquet"]).exit_code == 0
    forget()
    yield tmp_path / "mine.parquet"
    forget()


def test_an_episode_in_an_environment_of_the_users_own_is_replayed(own_run):
    """The module that registers it is imported first, as for the run."""
    result = RUN.invoke(app, ["replay", str(own_run), "--episode", "1"])
    assert result.exit_code == 0, result.output
    assert own_run.with_name("mine-episode-1.html").is_file()


def test_a_missing_module_is_named(own_run):
    """The message, without a traceback, names the missing module and the folder to run the command in."""
    own_run.with_name("short_road.py").unlink()
    error = RUN.invoke(app, ["replay", str(own_run), "--episode", "1"]).exception
    assert isinstance(error, ConfigError)
    assert "short_road" in str(error)
    assert "run this in the folder" in str(error)

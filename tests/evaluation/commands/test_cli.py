"""The commands do what their help says, and report an error in one line."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from evaluation import policies
from evaluation.commands.cli import app, main
from evaluation.commands.road_demo import check_road
from evaluation.commands.shared_options import read_settings, split
from evaluation.report.gallery import ROADS
from evaluation.settings import setting_of
from shield.config import ShieldConfig
from shield.errors import ConfigError

RUN = CliRunner()
_ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(Path.cwd()), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]),
}


def test_help_names_every_command():
    result = RUN.invoke(app, ["--help"])
    assert result.exit_code == 0
    for command in ("train", "evaluate", "demo", "picture", "figures", "config"):
        assert command in result.output


def test_config_prints_the_defaults():
    result = RUN.invoke(app, ["config"])
    assert ShieldConfig.from_toml(result.output) == ShieldConfig()


def test_lists_may_be_repeated_or_separated_by_commas():
    assert split(["none,full", " rss ", "full"]) == ["none", "full", "rss"]


def test_evaluate_prints_markdown_and_writes_three_tables(tmp_path):
    settings = tmp_path / "shield.toml"
    settings.write_text("braking = 7.0\n", encoding="utf-8")
    output = tmp_path / "out" / "x.csv"
    arguments = ["--policy", "slower", "--shield", "none,rss", "--episodes", "1", "--jobs", "1"]
    arguments += ["--config", str(settings), "--output", str(output), "--markdown"]
    result = RUN.invoke(app, ["evaluate", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    assert "| highway-fast | slower | rss (env) | 1 |" in re.sub(" +", " ", result.output)
    assert list(pd.read_csv(output)["seed"]) == [100_000, 100_000]
    assert (tmp_path / "out" / "x-summary.csv").is_file()
    assert (tmp_path / "out" / "x-comparison.csv").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--shield", "fulll"], "have none, distance, rss, ttc, ttc-ranking, full"),
        (["evaluate", "--policy", "fastest", "--jobs", "1"], "have faster, idle, slower, throttle, random"),
        (["evaluate", "--setting", "motorway"], "highway-fast"),
        (["evaluate", "--output", "x.xlsx"], ".csv or .parquet"),
        (["evaluate", "--config", "missing.toml"], "missing.toml"),
        (["train"], "either --recipe or --setting"),
        (["train", "--recipe", "none"], "ppo-highway-fast"),
    ],
)
def test_an_error_is_one_line_and_exit_code_2(arguments, message, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["shield", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    captured = capsys.readouterr()
    assert stop.value.code == 2
    assert message in captured.err
    assert captured.err.startswith("Error: ")
    assert len(captured.err.strip().splitlines()) == 1


def test_the_module_runs_as_a_program():
    done = subprocess.run([sys.executable, "-m", "evaluation.commands.cli", "config"], capture_output=True, text=True)
    assert done.returncode == 0
    assert 'mode = "full"' in done.stdout


def test_any_environment_is_evaluated_by_its_id(tmp_path):
    (tmp_path / "short.toml").write_text("lanes_count = 3\nduration = 3\n", encoding="utf-8")
    output = tmp_path / "new" / "x.parquet"
    arguments = ["--env-id", "highway-v0", "--env-config", str(tmp_path / "short.toml"), "--policy", "faster"]
    arguments += ["--episodes", "1", "--jobs", "1", "--output", str(output)]
    assert RUN.invoke(app, ["evaluate", *arguments], catch_exceptions=False).exit_code == 0
    assert set(pd.read_parquet(output)["setting"]) == {"highway-v0+short"}
    again = RUN.invoke(app, ["evaluate", *arguments])
    assert isinstance(again.exception, ConfigError)
    assert "exists already; --resume extends it, --force overwrites it" in str(again.exception)
    assert RUN.invoke(app, ["evaluate", *arguments, "--force"], catch_exceptions=False).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--env-id", "nothing-v0"], "there is no environment 'nothing-v0'"),
        (["--env-id", "no_module:nothing-v0"], "there is no environment"),
        (["--env-id", "CartPole-v1"], "CartPole-v1 is not a highway-env environment"),
        (
            ["--env-id", "highway-v0", "--env-config", "missing.toml"],
            "there is no environment configuration missing.toml",
        ),
        (["--env-id", "highway-v0", "--setting", "highway"], "give either --setting or --env-id"),
        (["--env-config", "x.toml"], "--env-config goes with --env-id"),
        (["--output", "/proc/none/x.csv"], "cannot be written"),
    ],
)
def test_an_invalid_evaluation_is_refused_before_the_first_episode(arguments, message):
    result = RUN.invoke(app, ["evaluate", "--policy", "faster", "--jobs", "1", *arguments])
    assert isinstance(result.exception, ConfigError)
    assert message in str(result.exception)


def test_an_environments_configuration_that_is_no_toml_is_named(tmp_path):
    (tmp_path / "bad.toml").write_text("lanes_count = = 3", encoding="utf-8")
    result = RUN.invoke(app, ["evaluate", "--env-id", "highway-v0", "--env-config", str(tmp_path / "bad.toml")])
    assert "is no TOML file" in str(result.exception)


def test_a_road_without_throttle_and_steering_is_answered_with_a_replacement(tmp_path):
    config = tmp_path / "inputs.toml"
    config.write_text('action = { type = "ContinuousAction" }', encoding="utf-8")
    result = RUN.invoke(app, ["evaluate", "--env-id", "two-way-v0", "--env-config", str(config)])
    assert isinstance(result.exception, ConfigError)
    assert "Have evaluation.wrappers:two-way-continuous-v0 instead" in str(result.exception)


def test_an_unknown_configuration_key_is_warned_of(tmp_path, capsys):
    config = tmp_path / "env.toml"
    config.write_text("vehicles_counts = 3\nduration = 2\nnonsense = 1\n", encoding="utf-8")
    (setting,) = read_settings(None, "highway-fast-v0", config)
    told = capsys.readouterr().err
    assert setting.config["duration"] == 2
    assert "no 'vehicles_counts' in its configuration, and ignores it; perhaps 'vehicles_count' is meant" in told
    assert "no 'nonsense' in its configuration, and ignores it\n" in told
    assert "duration" not in told


@pytest.mark.parametrize("policy", ["faster", "random"])
def test_several_egos_are_refused_with_the_wrapper_that_drives_them(policy):
    arguments = ["--env-id", "intersection-multi-agent-v0", "--policy", policy, "--episodes", "1", "--jobs", "1"]
    result = RUN.invoke(app, ["evaluate", *arguments])
    assert isinstance(result.exception, ConfigError)
    assert "several egos are driven by ShieldedEnv(env, ShieldConfig.simulated_traffic())" in str(result.exception)


def test_a_film_of_another_kind_is_refused_before_the_episode_is_driven(monkeypatch):
    monkeypatch.setattr("evaluation.running.episodes.run_episode", lambda *a, **k: pytest.fail("driven"))
    result = RUN.invoke(app, ["replay", "5", "--setting", "merge", "--film", "lost.mp4"])
    assert isinstance(result.exception, ConfigError)
    assert "written as .gif, not '.mp4'" in str(result.exception)


def test_the_demo_of_a_road_drives_it_and_draws_a_decision(tmp_path, monkeypatch):
    monkeypatch.setattr("evaluation.report.gallery._SEARCH", 1)
    arguments = ["demo", "--env-id", "merge-v0", "--episodes", "1", "--jobs", "1", "--output", str(tmp_path / "new")]
    assert RUN.invoke(app, arguments, catch_exceptions=False).exit_code == 0
    episodes = pd.read_parquet(tmp_path / "new" / "episodes.parquet")
    assert list(episodes["mode"]) == ["none", "full"]
    assert (tmp_path / "new" / "override.png").is_file()


@pytest.mark.parametrize(
    ("env_id", "why"),
    [
        ("racetrack-v0", "this environment takes ContinuousAction"),
        ("parking-v0", "this environment takes ContinuousAction"),
        ("intersection-multi-agent-v0", "this environment takes MultiAgentAction"),
        ("motorway-v0", "there is no environment 'motorway-v0'"),
    ],
)
def test_a_demo_that_cannot_be_lists_the_roads_that_can(env_id, why, tmp_path):
    output = tmp_path / "none"
    result = RUN.invoke(app, ["demo", "--env-id", env_id, "--jobs", "1", "--output", str(output)])
    assert isinstance(result.exception, ConfigError)
    for told in (f"not in {env_id}", why, ", ".join(ROADS)):
        assert told in str(result.exception)
    assert not output.exists()


def test_every_road_that_the_docs_and_the_refusal_name_can_be_demonstrated():
    """The environments that `make demo ENV=` accepts."""
    for road in ROADS:
        check_road(setting_of(road), ShieldConfig.simulated_traffic())
    page = Path(__file__).parents[3] / "docs" / "reference" / "cli.md"
    (line,) = re.findall(r"make demo ENV=(.*);", page.read_text(encoding="utf-8"))
    assert {f"{name}-v0" for name in re.findall(r"[a-z-]+", line.replace("another road", ""))} == set(ROADS)


def test_the_command_says_its_version_its_settings_and_its_help():
    assert RUN.invoke(app, ["--version"]).output.startswith("highway-shield ")
    assert "highway-fast-v0" in RUN.invoke(app, ["settings"]).output
    assert "[highway-fast]" in RUN.invoke(app, ["evaluate", "--help"]).output


def test_help_needs_nothing_that_is_slow_to_import():
    code = (
        "import sys; from evaluation.commands.cli import app; app(['--help'], standalone_mode=False);"
        "import shield, mpc; print([m for m in ('torch', 'numba', 'highway_env', 'pandas', 'casadi')"
        " if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip().endswith("[]"), done.stdout[-200:] + done.stderr[-2000:]


@pytest.mark.slow
def test_a_film_of_ones_own_model(tmp_path):
    path = tmp_path / "film.gif"
    zipped = str(Path(policies.__file__).parent / "ppo-highway-fast.zip")
    arguments = ["film", str(path), "--policy", zipped]
    assert RUN.invoke(app, arguments, catch_exceptions=False).exit_code == 0
    assert path.stat().st_size > 10_000
    assert "--force overwrites it" in str(RUN.invoke(app, arguments).exception)


def test_episodes_are_plotted_from_their_file(tmp_path):
    output, picture = tmp_path / "x.parquet", tmp_path / "plots" / "x.svg"
    arguments = ["--policy", "faster", "--shield", "none,full", "--episodes", "1", "--jobs", "1"]
    assert RUN.invoke(app, ["evaluate", *arguments, "--output", str(output)]).exit_code == 0
    result = RUN.invoke(app, ["plot", str(output), "--output", str(picture)])
    assert result.exit_code == 0, result.output
    text = picture.read_text(encoding="utf-8")
    assert text.count("<!-- no shield -->") == 2, "a label a row, in both rows of panels"
    assert "<!-- crashed [% of episodes] -->" in text
    assert RUN.invoke(app, ["plot", str(output)]).exit_code == 0
    assert output.with_suffix(".png").is_file()


def test_rows_are_plotted_against_noise(tmp_path):
    output, picture = tmp_path / "x.parquet", tmp_path / "x.svg"
    arguments = ["--setting", "highway-fast-seen", "--policy", "faster", "--shield", "none", "--episodes", "3"]
    arguments += ["--sensor", "exact,metric-1,metric-3", "--jobs", "1", "--output", str(output)]
    assert RUN.invoke(app, ["evaluate", *arguments]).exit_code == 0
    result = RUN.invoke(app, ["plot", str(output), "--noise", "--output", str(picture)])
    assert result.exit_code == 0, result.output
    text = picture.read_text(encoding="utf-8")
    assert "<!-- standard deviation of the noise [m, m/s] -->" in text
    assert text.count("<!-- highway-fast-seen, faster, no shield -->") == 1, "one line for all sensors"


def test_rows_of_one_sensor_are_not_plotted_against_noise(tmp_path):
    output = tmp_path / "x.parquet"
    arguments = ["--policy", "faster", "--shield", "none", "--episodes", "1", "--jobs", "1", "--output", str(output)]
    assert RUN.invoke(app, ["evaluate", *arguments]).exit_code == 0
    result = RUN.invoke(app, ["plot", str(output), "--noise"])
    assert "at least two sensors of one kind" in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.parquet"], "there is no file missing.parquet"),
        (["{table}"], "not a table of episodes: column 'crashed' is missing"),
        (["{table}", "--output", "{table}"], "already; --force"),
        (["{table}", "--output", "x.gif"], ".pdf, .png, .svg"),
    ],
)
def test_a_plot_of_something_else_is_refused(tmp_path, arguments, message, monkeypatch, capsys):
    table = tmp_path / "table.csv"
    table.write_text("seed,latencies_ms\n1,[]\n", encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["shield", "plot", *(text.format(table=table) for text in arguments)])
    with pytest.raises(SystemExit) as raised:
        main()
    assert raised.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("evaluate --policy fastr", "perhaps 'faster' is meant"),
        ("evaluate --policy missing.zip", "there is no policy file missing.zip"),
        ("evaluate --setting highway-fats", "perhaps 'highway-fast' is meant"),
        ("evaluate --shield ful", "perhaps 'full' is meant"),
        ("evaluate --perception simulatr", "perhaps 'simulator' is meant"),
        ("evaluate --sensor exakt", "perhaps 'exact' is meant"),
        ("evaluate --sensor exact+intents", "perhaps 'intent' is meant"),
        ("evaluate --simulator compild", "perhaps 'compiled' is meant"),
        ("evaluate --algorithm pppo", "perhaps 'ppo' is meant"),
        ("evaluate --model learnt", "perhaps 'learned' is meant"),
        ("evaluate --config missing.toml", "missing.toml"),
        (
            "evaluate --env-id highway-v0 --env-config missing.toml",
            "there is no environment configuration missing.toml",
        ),
        ("evaluate --output x.xlsx", ".csv or .parquet"),
        ("evaluate --resume", "--resume goes with --output"),
        ("evaluate --markdown --latex", "give one of --markdown and --latex"),
        ("train --setting highway-fats", "perhaps 'highway-fast' is meant"),
        ("train --recipe ppo-highway-fats", "perhaps 'ppo-highway-fast' is meant"),
        ("train --setting highway --algorithm pppo", "perhaps 'ppo' is meant"),
        ("certify x --policy fastr", "perhaps 'faster' is meant"),
        ("replay 5 --setting mergr", "perhaps 'merge' is meant"),
        ("replay --find missing.json", "there is no file missing.json"),
        ("falsify x.json --drivers blod", "perhaps 'bold' is meant"),
        ("rare --policy fastr", "perhaps 'faster' is meant"),
        ("film x.gif --policy ppo-highway-fats", "perhaps 'ppo-highway-fast' is meant"),
        ("table missing.csv", "there is no file missing.csv"),
        ("evaluate --jobs 0", "--jobs must be at least 1, or -1 for one per core"),
        ("certify x --jobs 0", "--jobs must be at least 1, or -1 for one per core"),
        ("falsify /proc/none/x.json", "/proc/none/x.json cannot be written"),
        ("train --setting highway --output /proc/none/x.zip", "/proc/none/x.zip cannot be written"),
        ("attack --setting roundabout,mergr", "perhaps 'merge' is meant"),
        ("rare --sensor exakt", "perhaps 'exact' is meant"),
    ],
)
def test_a_simple_error_is_reported_before_slow_imports(arguments, message, tmp_path):
    """In a fresh process, in which libraries that take seconds to import are not loaded."""
    slow = ("torch", "stable_baselines3", "highway_env", "pandas", "numba", "casadi", "matplotlib")
    code = (
        "import sys; from evaluation.commands.cli import main\n"
        "try: main()\n"
        "except SystemExit as stop: code = stop.code\n"
        f"print(code, [name for name in {slow} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments.split()], capture_output=True, text=True, cwd=tmp_path, env=_ENVIRONMENT
    )
    assert done.stdout.strip() == "2 []", done.stderr
    assert message in " ".join(done.stderr.split())
    assert not list(tmp_path.iterdir())


def test_the_tables_of_episodes_are_printed_again(tmp_path):
    output = tmp_path / "x.csv"
    arguments = [
        "--policy",
        "slower",
        "--shield",
        "none,rss",
        "--episodes",
        "1",
        "--jobs",
        "1",
        "--output",
        str(output),
    ]
    driven = RUN.invoke(app, ["evaluate", *arguments, "--latex"], catch_exceptions=False).stdout
    shown = RUN.invoke(app, ["table", str(output), "--latex"], catch_exceptions=False).stdout
    assert shown.count(r"\begin{tabular}") == 2
    assert shown.strip() in driven
    assert "| highway-fast | slower | rss (env) |" in re.sub(
        " +", " ", RUN.invoke(app, ["table", str(output), "--markdown"]).stdout
    )

"""Very many episodes are stored in parts, continued after a stop, and give an exact bound."""

import json
import re
import sys

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from typer.testing import CliRunner

from evaluation import Result
from evaluation.commands.cli import app, main
from evaluation.measuring.metrics import summarise
from evaluation.measuring.statistics import clopper_pearson
from evaluation.policies import reference_file
from evaluation.running import certify as certifying
from evaluation.running.certify import CertifyRun, certify, page
from evaluation.running.decision_log import MEASURED
from evaluation.running.episodes import run_episode, run_paired
from evaluation.running.identity import file_hash
from evaluation.running.records import ShieldVariant, config_on, variant_for
from evaluation.running.store_rows import is_store, read_store
from evaluation.settings import Setting, get_setting
from shield.config import ShieldConfig
from shield.errors import ConfigError

SHORT = Setting("short", "highway-fast-v0", {"duration": 3, "vehicles_count": 6})


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch):
    monkeypatch.setattr(certifying, "_PART", 3)


def asked(episodes=7, **changes):
    return CertifyRun(
        **{"setting": SHORT, "policy": "faster", "episodes": episodes, "seed": 50, "config": ShieldConfig(), **changes}
    )


def test_a_stopped_run_is_continued_without_repeated_episodes(tmp_path):
    def stop(part):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certify(asked(), tmp_path, progress=stop)
    (tmp_path / "parts" / "53-55.123.partial").write_bytes(b"cut off")
    driven = []
    whole = certify(asked(), tmp_path, progress=driven.append)
    assert [part["seed"].tolist() for part in driven] == [[53, 54, 55], [56]]
    assert whole["seed"].tolist() == list(range(50, 57))
    driven.clear()
    pd.testing.assert_frame_equal(certify(asked(), tmp_path, progress=driven.append), whole)
    assert not driven
    longer = certify(asked(9), tmp_path, progress=driven.append)
    assert longer["seed"].tolist() == list(range(50, 59))


def test_an_episode_of_certify_is_that_of_highway_env(tmp_path):
    found = certify(asked(3), tmp_path)
    assert set(found["simulator"]) == {"compiled"}
    record = run_episode(SHORT, "faster", ShieldVariant("env"), 51, simulator="highway-env")
    row = found.set_index("seed").loc[51]
    assert row["return"] == record.return_
    assert row["min_gap"] == record.min_gap
    assert row["min_margin"] == record.min_margin


def test_the_summary_leaves_out_unmeasured_columns(tmp_path):
    """Once it read latencies and reasons, which rows of a batch do not have."""
    certify(asked(3, policy="random"), tmp_path)
    rows = Result.read(tmp_path).summary.iloc[0]
    known = summarise(run_paired(SHORT, "random", [ShieldVariant("env")], range(50, 53))).iloc[0]
    unknown = {name for name in known.index if isinstance(known[name], float) and np.isnan(rows[name])}
    left_out = {"distance", "lane_changes", "laps", "mean_jerk", "mean_lateral_acceleration"}
    assert unknown >= {*left_out, "latency_p50_ms", "latency_p99_ms", "reason_unverified"}
    for name in (
        "episodes",
        "crash_rate",
        "return",
        "override_rate",
        "fallback_rate",
        "frame_override_rate",
        "min_gap",
    ):
        assert rows[name] == pytest.approx(known[name]), name
    text = Result.read(tmp_path).to_markdown()
    assert "fallback %" in text
    assert "latency" not in text
    done = CliRunner().invoke(app, ["report", str(tmp_path), "--replays", "0", "--output", str(tmp_path / "page.html")])
    assert done.exit_code == 0, done.output


def test_a_folder_of_another_run_is_refused(tmp_path):
    certify(asked(1), tmp_path)
    for change, told in (
        ({"policy": "idle"}, "another run: of the policies faster, and not idle"),
        ({"seed": 51}, r"another comparison: seed \(50, now 51\)"),
        ({"config": ShieldConfig(braking=6.0)}, r"shield short, env, full: braking \(.*, now 6.0\) differ"),
    ):
        with pytest.raises(ConfigError, match=rf"{told}.*; take a new folder"):
            certify(asked(1, **change), tmp_path)
    with pytest.raises(ConfigError, match="at least one"):
        certify(asked(0), tmp_path)
    with pytest.raises(ConfigError, match="cannot be written"):
        certify(asked(1), "/proc/nowhere")


def test_the_page_names_crashes_and_violations(tmp_path):
    found = certify(asked(5), tmp_path)
    text = page(found)
    assert "5 (15 decisions, 75 frames), seeds 50 to 54, simulated by compiled" in text
    assert "0; rate 0, 95 % Clopper-Pearson [0, 0.45]" in text
    assert "None." in text
    assert re.search(r"\| rules that were broken +\| none", text)
    found.loc[2, ["crashed", "violations", "min_gap", "rules"]] = [True, 3, 0.0, "crash 1, lanes 2"]
    found.loc[3, ["violations", "rules"]] = [1, "lanes 1"]
    text = page(found)
    assert "1; rate 0.2" in text
    assert "4 in 2 episodes" in text
    assert "crash 1, lanes 3" in text
    assert "|     52 | True" in text


@pytest.mark.parametrize(("count", "n"), [(0, 10), (0, 10**6), (3, 50), (50, 50)])
def test_the_bound_is_the_exact_clopper_pearson_bound(count, n):
    bound = clopper_pearson(count, n)
    if count:
        exact = stats.binomtest(count, n).proportion_ci(0.95, method="exact")
        assert (bound.low, bound.high) == pytest.approx((exact.low, exact.high))
    else:
        assert bound.high == pytest.approx(1 - 0.05 ** (1 / n), rel=1e-9)
    rng = np.random.default_rng(0)
    if 0 < count < n:
        # The bound's own promise: at its upper end so few are seen in at most one of forty samples.
        assert np.mean(rng.binomial(n, bound.high, 20_000) <= count) == pytest.approx(0.025, abs=0.01)


def test_the_command_writes_the_table_and_the_page_and_replays(tmp_path):
    run = CliRunner()
    arguments = ["certify", str(tmp_path), "--episodes", "2", "--seed", "60", "--jobs", "1"]
    result = run.invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "certificate.md").read_text(encoding="utf-8") in result.stdout
    assert pd.read_parquet(tmp_path / "episodes.parquet")["seed"].tolist() == [60, 61]
    film = tmp_path / "end.gif"
    result = run.invoke(app, ["replay", "60", "--film", str(film)])
    assert result.exit_code == 0, result.output
    assert film.stat().st_size > 10_000
    assert any("FASTER refused" in line and "the buffer would be short" in line for line in result.stdout.splitlines())
    assert run.invoke(app, ["replay", "--seed", "60"]).stdout.splitlines()[:5] == result.stdout.splitlines()[:5]
    assert isinstance(run.invoke(app, ["replay", "60", "--seed", "60"]).exception, ConfigError)


def test_an_error_of_certify_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["shield", "certify", str(tmp_path), "--policy", "mpc", "--simulator", "compiled"])
    with pytest.raises(SystemExit):
        main()
    assert "mpc may read highway-env's objects" in capsys.readouterr().err


def test_an_episode_on_a_network_of_roads_is_replayed_with_the_settings_of_its_traffic():
    """At the intersection, where others accelerate harder than elsewhere: the same that `shield evaluate` drives."""
    setting = get_setting("intersection")
    record = run_episode(setting, "faster", variant_for(config_on(setting)), 9, simulator="highway-env")
    shown = CliRunner().invoke(app, ["replay", "9", "--setting", "intersection"]).stdout
    for found in (record.return_, record.min_margin, record.violations):
        assert str(found) in shown
    assert config_on(setting) == ShieldConfig.simulated_traffic()
    assert config_on(setting, "worst-case").assumptions.acceleration == 6.0


def test_steering_behind_simulated_traffic_is_certified_at_every_frame(tmp_path):
    """Where inputs are verified by simulation the shield stands around the environment: with actions alone it would
    not see their frames."""
    options = ["--setting", "racetrack-minute", "--policy", "idle", "--episodes", "1", "--jobs", "1", "--seed", "60"]
    result = CliRunner().invoke(app, ["certify", str(tmp_path), *options])
    assert result.exit_code == 0, result.exception
    assert not pd.read_parquet(tmp_path / "episodes.parquet")["crashed"].any()


def test_a_folder_of_an_earlier_version_becomes_a_store(tmp_path):
    """Earlier versions kept parts beside asked.json: they are converted, and not driven again."""
    driven = []
    whole = certify(asked(), tmp_path)
    made, rows = read_store(tmp_path)
    assert [row["seed"] for row in rows] == list(range(50, 57))
    assert {"asked", "versions", "commit", "models", "machine"} <= made.keys()
    was = made["asked"]
    old = {
        "setting": was["settings"]["short"],
        "policy": was["policies"]["faster"],
        "seed": 50,
        "shield": was["shields"]["short, env, full"],
        "simulator": "auto",
        "version of": made["versions"],
    }
    for path in (tmp_path / "parts").glob("*.parquet"):
        pd.read_parquet(path).drop(columns=["placement", *MEASURED]).to_parquet(tmp_path / path.name)
        path.unlink()
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "asked.json").write_text(json.dumps({**made, "asked": old}), encoding="utf-8")
    again = certify(asked(), tmp_path, progress=driven.append)
    assert not driven
    assert is_store(tmp_path)
    pd.testing.assert_frame_equal(again, whole[[each for each in whole if each not in MEASURED]], check_like=True)
    assert len(certify(asked(9), tmp_path)) == 9
    assert read_store(tmp_path)[0]["asked"]["episodes"] == 9


def test_a_model_file_is_named_with_its_hash(tmp_path):
    certify(asked(1, policy="ppo-highway-fast", setting=get_setting("highway-fast")), tmp_path)
    models = read_store(tmp_path)[0]["models"]
    assert models == {"ppo-highway-fast.zip": file_hash(reference_file("ppo-highway-fast"))}

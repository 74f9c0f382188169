"""`shield reproduce shields`: its rows on each road, its continuation after a stop, and what it refuses."""

import json

import pytest
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.reproduction import shields, shields_table
from evaluation.running import episodes as episodes_module
from evaluation.running.episodes import run_episode
from evaluation.running.store_rows import read_store
from shield.errors import ConfigError, SceneError


def test_compared_shields_drive_the_same_seeds_and_continue(tmp_path, monkeypatch):
    """Their rows are in one store: finished ones are not driven again; a refusal of a road is reported and left out."""
    made = shields.variant_on

    def some(road, shield):
        if shield == "rss":
            raise ConfigError("not on this road")
        return made(road, shield)

    monkeypatch.setattr(shields_table, "variant_on", some)
    command = ["reproduce", "shields", "--road", "highway-fast", "--shield", "none,distance,rss,stopped", "--jobs", "1"]
    command += ["--out", str(tmp_path / "out"), "--episodes"]
    ended = CliRunner().invoke(app, [*command, "2"], catch_exceptions=False)
    assert "highway-fast, rss: not on this road" in ended.stdout.split("## Refused")[1]
    assert "CARPSS" in ended.stdout
    manifest, rows = read_store(tmp_path / "out")
    first = shields_table.FIRST_SEED
    named = {"highway-fast": {"none", "distance"}, "highway-fast, stopping": {"none"}}
    asked = [(road, mode, first + k) for road, modes in named.items() for mode in modes for k in range(2)]
    assert sorted((row["setting"], row["mode"], row["seed"]) for row in rows) == sorted(asked)
    assert manifest["asked"]["settings"].keys() == named.keys()
    assert manifest["asked"]["shields"].keys() >= {"highway-fast, env, distance"}
    assert manifest["models"].keys() == {"ppo-highway-fast.zip"}
    assert manifest["refused"] == {"highway-fast, rss": "not on this road"}
    chunk, driven = episodes_module._run_chunk, []

    def watched(asked, seeds):
        driven.extend(seeds)
        return chunk(asked, seeds)

    monkeypatch.setattr(episodes_module, "_run_chunk", watched)
    again = CliRunner().invoke(app, [*command, "2"], catch_exceptions=False)
    assert again.stdout == ended.stdout
    assert not driven
    CliRunner().invoke(app, [*command, "3"], catch_exceptions=False)
    assert driven == [first + 2] * 3
    assert read_store(tmp_path / "out")[0]["asked"]["episodes"] == 3
    page = CliRunner().invoke(app, ["report", str(tmp_path / "out"), "--replays", "0"], catch_exceptions=False)
    assert page.exit_code == 0


def test_shields_that_are_stopped_lose_no_episode(tmp_path, monkeypatch):
    """Each is on the disk before the next begins."""
    chunk, driven = episodes_module._run_chunk, []

    def stopped(asked, seeds):
        if len(driven) == 3:
            raise KeyboardInterrupt
        driven.extend(seeds)
        return chunk(asked, seeds)

    monkeypatch.setattr(episodes_module, "_run_chunk", stopped)
    monkeypatch.setattr("evaluation.running.processes.Processes.most", 1)
    with pytest.raises(KeyboardInterrupt):
        shields_table.compare_shields(tmp_path, 2, ["highway-fast"], ["slower", "idle"])
    assert len(read_store(tmp_path)[1]) == 3
    monkeypatch.setattr(episodes_module, "_run_chunk", chunk)
    text = shields_table.compare_shields(tmp_path, 2, ["highway-fast"], ["slower", "idle"])
    assert "| idle " in text
    assert len(read_store(tmp_path)[1]) == 4


def test_rows_of_shields_of_an_earlier_version_or_of_another_experiment_are_refused(tmp_path):
    (tmp_path / "old" / "episodes").mkdir(parents=True)
    with pytest.raises(ConfigError, match="earlier version, which was no store; take another --out"):
        shields_table.compare_shields(tmp_path / "old", 1, ["highway-fast"], ["slower"])
    shields_table.compare_shields(tmp_path / "new", 1, ["highway-fast"], ["slower"])
    made = json.loads((tmp_path / "new" / "manifest.json").read_text(encoding="utf-8"))
    made["versions"]["highway-env"] = "0.9"
    (tmp_path / "new" / "manifest.json").write_text(json.dumps(made), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"version of highway-env.*take another --out"):
        shields_table.compare_shields(tmp_path / "new", 1, ["highway-fast"], ["slower"])
    (tmp_path / "new" / "manifest.json").unlink()
    with pytest.raises(ConfigError, match=r"episodes without a manifest\.json.*take another --out"):
        shields_table.compare_shields(tmp_path / "new", 1, ["highway-fast"], ["slower"])


@pytest.mark.parametrize(("option", "said"), [("--road", "merge, roundabout"), ("--shield", "worst-case, simulated")])
def test_an_unknown_road_or_shield_lists_the_valid_ones(option, said, tmp_path):
    ended = CliRunner().invoke(app, ["reproduce", "shields", option, "nothing", "--out", str(tmp_path)])
    assert isinstance(ended.exception, ConfigError)
    assert said in str(ended.exception)


@pytest.mark.parametrize("road", list(shields.ROADS))
def test_baselines_stand_on_every_road_once(road):
    """The two agents of ABZ share a road; a car stops where there are meta-actions."""
    rows = shields.rows_of(shields.ROADS[road], shields.SHIELDS)
    if road == "abz-adversarial":
        assert not set(rows) & set(shields.BASELINES)
        return
    assert set(shields.BASELINES) < set(rows)
    refused = {"racetrack": "needs meta-actions", "merge": "ends at a place"}
    if road in refused:
        with pytest.raises(ConfigError, match=refused[road]):
            shields.driven_on(shields.ROADS[road], "stopped")
        return
    setting, policy = shields.driven_on(shields.ROADS[road], "stopped")
    record = run_episode(setting, policy, seed=7_000)
    assert record.crashed or record.mean_speed < 9.0


def test_four_decisions_are_four_seconds_at_1_hz():
    assert shields.variant_on(shields.ROADS["highway-fast"], "ttc-ranking").config.time_to_collision == 4.0


def test_the_ranking_of_the_model_is_walked_down(tmp_path):
    """Some override of the row ttc-ranking is no SLOWER, which all overrides of the plain rule are."""
    road = shields.ROADS["abz-adversarial"]
    variant, actions = shields.variant_on(road, "ttc-ranking"), []

    def watch(_, decision):
        if decision.overridden:
            actions.append(decision.executed)

    for seed in range(7_000, 7_003):
        run_episode(road.setting, road.policy, variant, seed, after=watch)
    assert set(actions) - {4}


@pytest.mark.parametrize("error", [ConfigError("not here"), SceneError("not here")])
def test_a_refusal_of_a_road_while_driving_is_reported(error, tmp_path, monkeypatch):
    """The other rows are still driven."""
    drive = shields_table.run_paired

    def refusing(setting, policy, variants, seeds, **options):
        if variants[0].mode == "rss":
            raise error
        return drive(setting, policy, variants, seeds, **options)

    monkeypatch.setattr(shields_table, "run_paired", refusing)
    text = shields_table.compare_shields(tmp_path, 1, ["highway-fast"], ["rss", "slower"])
    assert "highway-fast, rss: not here" in text.split("## Refused")[1]
    assert "| slower " in text


def test_no_two_rows_have_the_same_name():
    """They share one store, which identifies them by setting, policy and the variant."""
    parts, _ = shields_table._parts(shields.ROADS.values(), shields.SHIELDS, 1)
    names = [(each.setting.name, each.policy, each.variant.place, each.variant.mode) for each in parts]
    assert len(names) > 50
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("road", ["merge", "roundabout", "intersection"])
def test_a_rule_alone_is_refused_on_networks(road):
    with pytest.raises(ConfigError, match="straight parallel lanes"):
        shields.variant_on(shields.ROADS[road], "ttc-ranking")

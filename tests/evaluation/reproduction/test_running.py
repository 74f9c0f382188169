"""`shield reproduce highway`: its files, its continuation after a stop, and its verdict on the claims."""

import json

import numpy as np
import pandas as pd
import pytest
from stable_baselines3 import PPO
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.reproduction import running
from evaluation.reproduction.driving import COLUMNS
from evaluation.reproduction.presets import PRESETS, PUBLISHED, get_preset
from evaluation.reproduction.running import FIRST_SEED, Reproduction, run, unsupported_reason
from evaluation.reproduction.table import summary, table
from evaluation.reproduction.variants import VARIANTS, get_variants
from evaluation.reproduction.verdict import judge
from evaluation.running.identity import file_hash
from evaluation.running.parts import Parts
from evaluation.running.store_rows import read_store
from shield.errors import ConfigError

SMALL = ["--seeds", "2", "--episodes", "4", "--pooled", "1", "--steps", "64", "--jobs", "1"]
ROWS = "slower,stopped,noise,shielded-env,shielded-env-observed"


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reproduce") / "out"
    command = ["reproduce", "highway", "--variant", ROWS, *SMALL, "--out", str(folder)]
    ended = CliRunner().invoke(app, command, catch_exceptions=False)
    assert ended.exit_code == 0
    return folder, ended


def test_a_run_writes_the_table_the_episodes_and_the_manifest(driven):
    folder, ended = driven
    episodes = pd.read_parquet(folder / "episodes.parquet")
    assert {"preset", "variant", "training_seed", *COLUMNS} <= set(episodes.columns)
    assert episodes.groupby("variant").size().to_dict() == {
        **dict.fromkeys(("slower", "stopped", "noise", "shielded-env"), 8),
        "shielded-env-observed": 2,
    }
    assert set(episodes["seed"]) == {FIRST_SEED + 10_000 * k + i for k in range(2) for i in range(4)}
    assert len(pd.read_csv(folder / "episodes.csv")) == len(episodes)
    text = (folder / "table.md").read_text(encoding="utf-8")
    for row in ("always SLOWER", "a car that stops", "16.97 ± 7.68", "noise + `ShieldedEnv`"):
        assert row in text
    assert text.strip() in ended.stdout
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    models = {path.name: file_hash(path) for path in (folder / "models").glob("*.zip")}
    assert manifest["models"] == models
    assert set(models) == {"noise-0.zip", "noise-1.zip"}
    assert {"commit", "versions", "asked", "command", "machine"} <= set(manifest)
    spent = manifest["CPU seconds of parts"]
    parts = [Parts(folder).record(name)["cpu_seconds"] for name in Parts(folder).names]
    assert spent["total"] == pytest.approx(sum(sum(each.values()) for each in parts), abs=1.0)
    assert spent["noise"]["training"] > 0.0
    assert spent["slower"]["training"] == pytest.approx(0.0, abs=0.05)
    claims = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))["claims"]
    assert {"noise-confidence", "shielded-env-crashes"} <= {each["name"] for each in claims}
    assert all(isinstance(each["holds"], bool) and each["sentence"] for each in claims)


def test_finished_episodes_are_not_repeated_and_more_are_added(driven, monkeypatch):
    """The same command drives and trains nothing; with more episodes it drives only those, with the same models."""
    folder, _ = driven
    variants = tuple(get_variants(ROWS.split(",")))
    asked = Reproduction(get_preset("as-coded"), variants, 2, 4, 1, 64)
    before, asked_for = pd.read_parquet(folder / "episodes.parquet"), []
    drive = running.drive_many

    def watched(preset, variant, model, seeds):
        asked_for.extend(seeds)
        return drive(preset, variant, model, seeds)

    monkeypatch.setattr(running, "drive_many", watched)
    monkeypatch.setattr(running, "train_variant", None)
    pd.testing.assert_frame_equal(run(asked, folder), before)
    assert not asked_for
    longer = run(Reproduction(asked.preset, variants, 2, 5, 1, 64), folder)
    assert set(asked_for) == {FIRST_SEED + 4, FIRST_SEED + 10_004}
    assert len(longer) == len(before) + 2 * 4
    pd.testing.assert_frame_equal(run(asked, folder), before)


def test_parts_of_another_experiment_are_refused(driven):
    folder, _ = driven
    asked = Reproduction(get_preset("as-coded"), tuple(get_variants(["noise"])), 2, 4, 1, 128)
    with pytest.raises(ConfigError, match="of noise, training steps"):
        run(asked, folder)
    (folder / "models" / "noise-1.zip").write_bytes((folder / "models" / "noise-0.zip").read_bytes())
    with pytest.raises(ConfigError, match=r"noise-1\.zip"):
        run(Reproduction(get_preset("as-coded"), tuple(get_variants(["noise"])), 2, 4, 1, 64), folder)


def test_a_stopped_run_continues_with_the_next_part(tmp_path, monkeypatch):
    """The rows are those of an uninterrupted run; a truncated file does not count as a part."""
    asked = Reproduction(get_preset("as-coded"), tuple(get_variants(["slower", "idle", "faster"])), 2, 3)
    whole = run(asked, tmp_path / "whole")
    drive, calls = running.drive_many, []

    def stopped(preset, variant, model, seeds):
        calls.append(variant.name)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return drive(preset, variant, model, seeds)

    monkeypatch.setattr(running, "drive_many", stopped)
    with pytest.raises(KeyboardInterrupt):
        run(asked, tmp_path / "parts")
    (tmp_path / "parts" / "parts" / "faster-0.7.partial").write_bytes(b"cut off")
    pd.testing.assert_frame_equal(run(asked, tmp_path / "parts"), whole)
    assert len(calls) == 2 + 1 + 4


def test_training_again_gives_the_same_model(tmp_path):
    asked = Reproduction(get_preset("as-coded"), tuple(get_variants(["skills-inside"])), 1, 2, 1, 64)
    for name in ("one", "two"):
        run(asked, tmp_path / name)
    models = [PPO.load(tmp_path / name / "models" / "skills-inside-0.zip", device="cpu") for name in ("one", "two")]
    one, two = (model.policy.state_dict() for model in models)
    assert all((one[key] == two[key]).all() for key in one)
    manifest = json.loads((tmp_path / "one" / "models" / "skills-inside-0.json").read_text(encoding="utf-8"))
    assert manifest["crashes_in_training"] == 0
    assert manifest["steps_taken"] == 1024


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--preset", "as-code"], "as-coded, as-written"),
        (["--variant", "noize"], "noise, noise-intent"),
        (["--jobs", "0"], "--jobs must be at least 1"),
        (["--road", "merge"], "go with the table shields"),
    ],
)
def test_an_unknown_name_lists_the_valid_ones(options, said, tmp_path):
    ended = CliRunner().invoke(app, ["reproduce", "highway", *options, "--out", str(tmp_path)])
    assert isinstance(ended.exception, ConfigError)
    assert said in str(ended.exception)


def test_a_file_in_the_folders_place_is_refused(tmp_path):
    (tmp_path / "out").write_text("")
    ended = CliRunner().invoke(app, ["reproduce", "highway", "--variant", "slower", "--out", str(tmp_path / "out")])
    assert "is a file" in str(ended.exception)


def test_a_model_that_drives_another_row_comes_with_it():
    assert [each.name for each in get_variants(["shielded-env"])] == ["noise", "shielded-env"]
    assert [each.name for each in get_variants()] == [name for name in VARIANTS if name != "provided-baseline"]
    assert [each.name for each in get_variants(road="roundabout")] == list(VARIANTS)


def test_an_unavailable_variant_states_the_reason():
    """The planner's model has steps of one second; the decisions of the text take a tenth."""
    assert "1 Hz" in unsupported_reason(PRESETS["as-written"], VARIANTS["cem"])
    assert unsupported_reason(PRESETS["as-coded"], VARIANTS["trained-inside"]) == ""


def test_the_roundabout_is_compiled_and_has_seeds_of_its_own(tmp_path):
    """Rows behind the shield, which simulates the traffic there, have the smaller count."""
    variants = tuple(get_variants(["faster", "shielded-env"], "roundabout"))
    asked = Reproduction(get_preset("as-coded", "roundabout"), variants, seeds=2, episodes=3, pooled=1, steps=64)
    rows = run(asked, tmp_path)
    assert rows.groupby("variant").size().to_dict() == {"faster": 6, "noise": 6, "shielded-env": 2}
    assert sorted(set(rows["seed"])) == [1_830_000, 1_830_001, 1_830_002, 1_831_000, 1_831_001, 1_831_002]
    assert set(rows["simulator"]) == {"compiled"}
    with pytest.raises(ConfigError, match="at most 1,000 for each training seed, not 1,001"):
        Reproduction(asked.preset, variants, episodes=1_001)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("shield-actions", "its row is this one"),
        ("shielded-env-observed", "straight highways only"),
        ("cem", "15 Hz"),
        ("trained-inside-masks", ""),
    ],
)
def test_a_variant_left_out_on_the_roundabout_states_the_reason(name, reason):
    found = unsupported_reason(get_preset("as-coded", "roundabout"), VARIANTS[name])
    assert (reason in found) if reason else not found


def episodes(rates, n=200, **columns):
    """Episodes of variants with these crash rates, two training seeds each."""
    frames = []
    for name, rate in rates.items():
        for seed in range(2):
            crashed = np.arange(n) < rate * n
            row = {"preset": "as-coded", "variant": name, "training_seed": seed, "seed": seed * n + np.arange(n)}
            rest = {"return": 21.0 - 12.0 * crashed, "steps": 30, "decisions": 30, "mean_speed": 21.0}
            counts = dict.fromkeys(("slow", "replaced", "overridden"), 3)
            frames.append(pd.DataFrame({**row, "crashed": crashed, **rest, **counts, "confidence": 0.74, **columns}))
    return pd.concat(frames, ignore_index=True)


@pytest.mark.parametrize(
    ("rates", "name", "holds"),
    [
        ({"ppo": 0.0, "noise": 0.3}, "noise-crashes", True),
        ({"ppo": 0.3, "noise": 0.3}, "noise-crashes", False),
        ({"ppo": 0.0}, "ppo-0", True),
        ({"ppo": 0.01}, "ppo-0", False),
        ({"noise-override": 0.9}, "noise-override-range", True),
        ({"noise-override": 0.5}, "noise-override-range", False),
        ({"noise": 0.25}, "noise-published", True),
        ({"noise": 0.9}, "noise-published", False),
        ({"noise": 0.2}, "noise-confidence", True),
        ({"shielded-env": 0.005}, "shielded-env-crashes", False),
        ({"skills-inside": 0.0, "slower": 0.05}, "skills-inside-figure", False),  # returns 21.0, not 21.6
    ],
)
def test_a_claim_holds_where_the_episodes_say_so(rates, name, holds):
    found = {each.name: each.holds for each in judge(episodes(rates))}
    assert found[name] is holds


def test_the_table_shows_each_training_seed_and_the_published_value():
    found = summary(episodes({"slower": 0.05, "noise": 0.25}))
    assert found["crash_rates"].tolist() == [[0.05], [0.25, 0.25]]
    text = table(found)
    assert "25.0 25.0" in text
    published = PUBLISHED["noise"]
    assert f"{published.mean} ± {published.deviation}" in text


def test_a_folder_of_an_earlier_version_becomes_a_store(tmp_path, monkeypatch):
    """Earlier versions kept rows in episodes/ with a record beside each: they are converted, and not driven again."""
    asked = Reproduction(get_preset("as-coded"), tuple(get_variants(["slower", "idle"])), 2, 3)
    whole = run(asked, tmp_path)
    made, rows = read_store(tmp_path)
    assert len(rows) == len(whole) == 12
    assert {"asked", "versions", "commit", "models", "machine"} <= made.keys()
    parts, old = Parts(tmp_path), tmp_path / "episodes"
    assert {parts.record(name)["commit"] for name in parts.names} == {made["commit"]}
    old.mkdir()
    for name in parts.names:
        record = parts.record(name)
        record["revision"] = record.pop("commit")
        (old / f"{name}.json").write_text(json.dumps(record), encoding="utf-8")
        (tmp_path / "parts" / f"{name}.parquet").rename(old / f"{name}.parquet")
    monkeypatch.setattr(running, "drive_many", lambda *_: pytest.fail("driven again"))
    pd.testing.assert_frame_equal(run(asked, tmp_path), whole)
    assert read_store(tmp_path)[0]["commits of parts"] == [made["commit"]]
    assert not list(old.iterdir())

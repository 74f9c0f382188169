"""Experiments in Python: any policy and environment, with the episodes of the command line, on one machine or
several."""

import gymnasium as gym
import highway_env  # noqa: F401  (registers the environments)
import numpy as np
import pandas as pd
import pytest
from stable_baselines3 import PPO
from typer.testing import CliRunner

from evaluation import Experiment, Result, compare, evaluate, merge, run_paired
from evaluation.commands.cli import app
from evaluation.running.records import ShieldVariant
from shield.errors import ConfigError, PolicyError

SHORT = {"duration": 3, "vehicles_count": 10}
TIMES = ["latencies_ms", "latency_p50_ms", "latency_p99_ms", "latency_max_ms", "simulator"]


def same(one, two):
    """Tables of the same episodes; the compiled simulator gives the rows of highway-env itself."""
    one, two = (frame.drop(columns=TIMES).fillna(np.nan) for frame in (one, two))
    pd.testing.assert_frame_equal(one, two, check_dtype=False)


@pytest.fixture(scope="module", autouse=True)
def short_environment():
    gym.register("short-highway-v0", entry_point="highway_env.envs:HighwayEnvFast", kwargs={"config": SHORT})
    yield
    del gym.registry["short-highway-v0"]


def test_the_rows_are_those_of_paired_episodes():
    result = evaluate("faster", "short-highway-v0", shield=["none", "full"], episodes=3)
    assert result.episodes["mode"].tolist() == ["none"] * 3 + ["full"] * 3
    from evaluation import setting_of

    bare = run_paired(setting_of("short-highway-v0"), "faster", [ShieldVariant()], range(100_000, 100_003))
    same(result.episodes[:3], bare)


def test_a_model_a_file_and_a_function_drive_under_their_names(tmp_path):
    env = gym.make("short-highway-v0")
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu")

    def always_slower(observation):
        return 4

    policies = {"mine": model, "slow": always_slower}
    result = evaluate(policies, env, episodes=2, config="worst-case")
    assert result.summary[["policy", "mode"]].drop_duplicates().to_numpy().tolist() == [
        *(["mine", mode] for mode in ("none", "full")),
        *(["slow", mode] for mode in ("none", "full")),
    ]
    slower = evaluate("slower", env, episodes=2, config="worst-case").episodes
    same(result.episodes[result.episodes["policy"] == "slow"].reset_index(drop=True), slower.assign(policy="slow"))
    model.save(tmp_path / "saved.zip")
    named = evaluate({"other": tmp_path / "saved.zip"}, env, episodes=2, config="worst-case").episodes
    same(named, result.episodes[result.episodes["policy"] == "mine"].assign(policy="other").reset_index(drop=True))
    assert evaluate(always_slower, env, episodes=1).episodes["policy"].unique() == ["always_slower"]
    env.close()


def test_tables_and_files_come_of_a_result(tmp_path):
    result = evaluate("faster", "short-highway-v0", episodes=2)
    assert "crashed" in result.to_markdown() or "crash" in result.to_markdown()
    assert result.to_latex("comparison").startswith(r"\begin{tabular}")
    assert len(result.table("comparison")) == 1
    assert result.plot(tmp_path / "plot.svg").stat().st_size > 1000
    again = Result.read(result.write(tmp_path / "episodes.parquet"))
    same(again.episodes, result.episodes)
    assert again.made["asked"] == result.made["asked"]
    assert {"versions", "commit", "machine", "command"} <= again.made.keys()
    pd.testing.assert_frame_equal(compare(result), result.comparison)
    with pytest.raises(ConfigError, match="valid are summary, comparison"):
        result.table("crashes")
    with pytest.raises(ConfigError, match="same seed appears twice"):
        compare(result, again)


def test_shards_are_the_whole(tmp_path):
    asked = Experiment("random", "short-highway-v0", episodes=5)
    whole = asked.run(progress=False)
    parts = [asked.with_options(shard=(i, 2), output=tmp_path / f"{i}.parquet").run(False) for i in (1, 2)]
    assert [len(part.episodes) for part in parts] == [6, 4]
    read = [Result.read(tmp_path / f"{i}.parquet") for i in (2, 1)]
    same(merge(read).episodes, whole.episodes)
    assert merge(read).made["asked"] == whole.made["asked"]


def test_shards_that_do_not_fit_are_refused():
    asked = Experiment("faster", "short-highway-v0", episodes=4, shield="none")
    one, two = (asked.with_options(shard=(i, 2)).run(False) for i in (1, 2))
    other = asked.with_options(shard=(2, 2), env="short-highway-v0", episodes=6).run(False)
    with pytest.raises(ConfigError, match="two experiments: episodes"):
        merge([one, other])
    with pytest.raises(ConfigError, match=r"shards 1 to 2; these are \[1\]"):
        merge([one])
    with pytest.raises(ConfigError, match=r"these are \[1, 1\]"):
        merge([one, one])
    with pytest.raises(ConfigError, match="made without a shard"):
        merge([asked.run(False)])
    torn = Result(two.episodes[:1], two.made)
    with pytest.raises(ConfigError, match=r"1 episodes of .* are missing, the first has seed 100003"):
        merge([one, torn])


def test_the_command_line_drives_the_same_experiment(tmp_path):
    run = CliRunner().invoke
    for i in (1, 2):
        args = f"evaluate --env-id short-highway-v0 --policy faster --episodes 4 --jobs 1 --shard {i}/2 --output"
        done = run(app, [*args.split(), str(tmp_path / f"{i}.csv")])
        assert done.exit_code == 0, done.output
    merged = run(app, ["merge", *(str(tmp_path / f"{name}.csv") for name in ("whole", 1, 2))])
    assert merged.exit_code == 0, merged.output
    whole = Experiment("faster", "short-highway-v0", episodes=4).run(False)
    same(Result.read(tmp_path / "whole.csv").episodes, whole.episodes)
    wrong = run(app, ["evaluate", "--shard", "3/2"])
    assert "i/n" in str(wrong.exception)


def test_a_file_describes_an_experiment(tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text('policy = ["faster", "idle"]\nenv = "short-highway-v0"\nepisodes = 2\nshard = [1, 2]\n')
    assert Experiment.from_toml(path) == Experiment(["faster", "idle"], "short-highway-v0", episodes=2, shard=(1, 2))
    path.write_text("episode = 2\n")
    with pytest.raises(ConfigError, match="perhaps 'episodes' is meant"):
        Experiment.from_toml(path)


def test_invalid_arguments_are_refused_at_construction(tmp_path):
    with pytest.raises(ConfigError, match="perhaps 'full' is meant"):
        Experiment("faster", shield="ful")
    with pytest.raises(ConfigError, match="perhaps 'episodes' is meant"):
        evaluate("faster", episode=3)
    with pytest.raises(ConfigError, match="both be reported as 'a'"):
        Experiment([tmp_path / "a.zip", "b/a.zip"])
    with pytest.raises(ConfigError, match="shards"):
        Experiment("faster", episodes=2, shard=(1, 3))
    wrapped = gym.wrappers.FlattenObservation(gym.make("short-highway-v0"))
    with pytest.raises(ConfigError, match="FlattenObservation around the environment would be lost"):
        evaluate("faster", wrapped)
    with pytest.raises(ConfigError, match="save the model"):
        evaluate(lambda obs: 1, "short-highway-v0", output=tmp_path / "out.csv", resume=True)
    with pytest.raises(ConfigError, match="reported as 'slower'"):
        evaluate({"brake": "slower"}, "short-highway-v0", episodes=1)
    with pytest.raises(PolicyError, match="no predict"):
        evaluate({"none": 3.5}, "short-highway-v0", episodes=1)


def test_an_output_is_continued_with_resume(tmp_path):
    path = tmp_path / "episodes.parquet"
    first = evaluate("idle", "short-highway-v0", episodes=2, output=path)
    more = evaluate("idle", "short-highway-v0", episodes=3, output=path, resume=True)
    assert len(more.episodes) == 6
    kept = more.episodes[more.episodes["seed"] < 100_002]
    assert (
        np.concatenate(kept["latencies_ms"].tolist()).tolist()
        == np.concatenate(first.episodes["latencies_ms"].tolist()).tolist()
    )


def test_the_folder_of_the_output_is_made_or_it_is_said_why_not(tmp_path):
    """A run into a folder that is not there yet begins; one into a folder that cannot be there says so."""
    evaluate("slower", "highway-fast", shield="none", episodes=1, output=tmp_path / "new" / "folder" / "x.parquet")
    assert (tmp_path / "new" / "folder" / "x.parquet").is_file()
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be made"):
        evaluate("slower", "highway-fast", shield="none", episodes=1, output=tmp_path / "file" / "x.parquet")

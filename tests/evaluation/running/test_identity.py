"""Rows made with another configuration are never mixed in: every determining input is recorded and compared."""

import json
import re
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from typer.testing import CliRunner

from evaluation.commands.cli import app
from evaluation.falsification.finds import Find, made_with, replay
from evaluation.running import manifest as storing
from evaluation.running.certify import CertifyRun, certify
from evaluation.running.episodes import RunOptions, run_paired
from evaluation.running.identity import differences, of_environment, of_policy, policy_files
from evaluation.running.records import ShieldVariant
from evaluation.running.store import Store
from evaluation.settings import Setting
from shield.config import ShieldConfig
from shield.errors import ConfigError

RUN = CliRunner()
CONFIG = {"duration": 2, "vehicles_count": 3}
SHORT = Setting("short", "highway-fast-v0", CONFIG)


def save(path, seed, prefers=None):
    """An untrained model; with `prefers` it proposes that action only."""
    model = PPO("MlpPolicy", gym.make("highway-fast-v0"), n_steps=8, batch_size=8, seed=seed, device="cpu")
    if prefers is not None:
        model.policy.action_net.bias.data[prefers] = 1e3
    model.save(path)


def evaluate(folder, *more, toml="duration = 2\nvehicles_count = 3\n"):
    (folder / "short.toml").write_text(toml, encoding="utf-8")
    arguments = ["evaluate", "--env-id", "highway-fast-v0", "--env-config", str(folder / "short.toml"), "--jobs", "1"]
    arguments += ["--policy", str(folder / "model.zip"), "--episodes", "2", "--shield", "none"]
    return RUN.invoke(app, [*arguments, "--output", str(folder / "x.parquet"), *more])


def stopped(folder, monkeypatch):
    """A run that was interrupted after its first episode."""
    add, driven = Store.add, []

    def once(self, rows):
        if driven:
            raise KeyboardInterrupt
        driven.append(rows)
        add(self, rows)

    with monkeypatch.context() as patched:
        patched.setattr(Store, "add", once)
        assert evaluate(folder).exit_code == 130
    assert len((folder / "x.parquet.episodes" / "open.jsonl").read_bytes().splitlines()) == 1


def replace_model(folder):
    save(folder / "model.zip", 1)


def add_statistics(folder):
    VecNormalize(DummyVecEnv([lambda: gym.make("highway-fast-v0")])).save(folder / "model_vecnormalize.pkl")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (replace_model, r"policy model: file \(\w+, now \w+\) differ"),
        (add_statistics, r"policy model: statistics \(none, now \w+\) differ"),
    ],
)
@pytest.mark.parametrize("finished", [False, True])
def test_rows_of_another_model_are_not_continued(change, told, finished, tmp_path, monkeypatch):
    """The zip of --policy, or its statistics, is replaced between two runs: two policies with one name."""
    save(tmp_path / "model.zip", 0)
    if finished:
        assert evaluate(tmp_path).exit_code == 0
    else:
        stopped(tmp_path, monkeypatch)
    change(tmp_path)
    result = evaluate(tmp_path, "--resume")
    assert isinstance(result.exception, ConfigError)
    assert re.search(told, str(result.exception))
    assert "--force begins again, another --output keeps both" in str(result.exception)
    # The remedy in the message works.
    assert evaluate(tmp_path, "--output", str(tmp_path / "y.parquet")).exit_code == 0
    assert evaluate(tmp_path, "--force").exit_code == 0


def test_rows_of_another_environment_or_shield_are_not_continued(tmp_path, monkeypatch):
    save(tmp_path / "model.zip", 0)
    stopped(tmp_path, monkeypatch)
    shield = tmp_path / "shield.toml"
    shield.write_text("braking = 7.0\n", encoding="utf-8")
    for more, toml, told in (
        (
            (),
            "duration = 3\nvehicles_count = 3\n",
            r"setting highway-fast-v0\+short: configuration duration \(2, now 3\)",
        ),
        (
            ("--config", str(shield)),
            "duration = 2\nvehicles_count = 3\n",
            r"shield .*, none, none: braking \(.*, now 7.0\)",
        ),
        (("--seed", "7"), "duration = 2\nvehicles_count = 3\n", r"seed \(100000, now 7\)"),
    ):
        result = evaluate(tmp_path, "--resume", *more, toml=toml)
        assert isinstance(result.exception, ConfigError)
        assert re.search(told, str(result.exception)), result.exception
    monkeypatch.setattr(storing, "versions", lambda: {"highway-env": "1.10.1"})
    result = evaluate(tmp_path, "--resume")
    assert re.search(r"version of highway-env \(.*, now 1.10.1\)", str(result.exception))


def test_an_identical_run_is_continued(tmp_path, monkeypatch):
    save(tmp_path / "model.zip", 0)
    stopped(tmp_path, monkeypatch)
    assert evaluate(tmp_path, "--resume").exit_code == 0
    found = pd.read_parquet(tmp_path / "x.parquet")
    assert found["seed"].tolist() == [100_000, 100_001]
    assert len(found.attrs["made"]["earlier"]) == 1


def test_the_source_of_a_users_environment_is_compared(tmp_path, monkeypatch):
    """The class and its wrappers are the user's: their file is hashed, with its package."""
    module = tmp_path / "an_environment_of_mine.py"
    text = (
        "import gymnasium as gym\n"
        "from highway_env.envs.highway_env import HighwayEnvFast\n"
        "class Mine(HighwayEnvFast):\n"
        "    def _reward(self, action):\n"
        "        return 1.0\n"
        "gym.register('of-mine-v0', entry_point=Mine)\n"
    )
    module.write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    setting = Setting("mine", "an_environment_of_mine:of-mine-v0", CONFIG)
    before = of_environment(setting)
    assert set(before["source"]) == {"an_environment_of_mine"}
    assert differences(before, of_environment(setting)) == []
    assert of_environment(SHORT)["source"] == {}
    module.write_text(text.replace("1.0", "2.0"), encoding="utf-8")
    assert [each.split(" (")[0] for each in differences(before, of_environment(setting))] == [
        "source an_environment_of_mine"
    ]
    gym.registry.pop("of-mine-v0")
    sys.modules.pop("an_environment_of_mine")


def test_the_identity_of_a_row_is_plain_data_and_repeatable():
    for setting in (
        SHORT,
        Setting("at", "intersection-v0"),
        Setting("lot", "parking-v0"),
        Setting("track", "racetrack-v0"),
    ):
        found = of_environment(setting)
        assert json.loads(json.dumps(found)) == found == of_environment(setting)
    assert of_environment(SHORT)["configuration"]["duration"] == 2
    assert of_environment(Setting("keep", "lane-keeping-v0"))["decisions at most"] == 200
    assert policy_files("faster") == {}
    assert set(of_policy("ppo-highway-fast")) == {"file", "source"}


def test_a_folder_of_parts_is_not_continued_with_another_model(tmp_path):
    model = tmp_path / "model.zip"
    save(model, 0)
    asked = CertifyRun(SHORT, str(model), 2, 50, ShieldConfig())
    certify(asked, tmp_path / "parts")
    certify(asked, tmp_path / "parts")
    save(model, 1)
    with pytest.raises(
        ConfigError, match=r"another comparison: policy model: file \(\w+, now \w+\) differ; take a new folder"
    ):
        certify(asked, tmp_path / "parts")
    certify(asked, tmp_path / "other")


def test_a_model_that_is_saved_again_is_driven_again_in_the_same_process(tmp_path):
    """Drivers are kept from episode to episode: not those of a file that has been written since."""
    model = tmp_path / "model.zip"
    returns = []
    for action in (3, 4):
        save(model, 0, prefers=action)
        frame = run_paired(SHORT, str(model), [ShieldVariant()], [7], run=RunOptions(store=Store(None, {})))
        returns.append(frame["mean_speed"].item())
        found = certify(CertifyRun(SHORT, str(model), 1, 7, ShieldConfig()), tmp_path / str(action))
        returns.append(found["mean_speed"].item())
    assert returns[0] > returns[2]
    assert returns[1] > returns[3]


def test_a_find_is_not_replayed_with_another_model(tmp_path):
    model, path = tmp_path / "model.zip", tmp_path / "find.json"
    save(model, 0)
    setting = Setting("road", "merge-v0", {})
    shield = ShieldConfig(mode="none").to_toml()
    Find("merge-v0", {}, shield, str(model), (), (), 0.0, seed=3, made=made_with(setting, str(model))).save(path)
    again = replay(Find.load(path)).clearance
    assert np.isfinite(again)
    save(model, 1)
    with pytest.raises(ConfigError, match=r"policy file \(\w+, now \w+\) differ; search again"):
        replay(Find.load(path))
    data = json.loads(path.read_text(encoding="utf-8"))
    del data["made"]
    path.write_text(json.dumps(data), encoding="utf-8")
    replay(Find.load(path))


def test_two_models_of_equal_name_are_refused(tmp_path):
    for k in (0, 1):
        (tmp_path / str(k)).mkdir()
        save(tmp_path / str(k) / "best_model.zip", k)
    both = ",".join(str(tmp_path / str(k) / "best_model.zip") for k in (0, 1))
    result = RUN.invoke(app, ["evaluate", "--policy", both, "--episodes", "1", "--jobs", "1"])
    assert isinstance(result.exception, ConfigError)
    assert "would both be reported as 'best_model'" in str(result.exception)


def test_a_finished_output_is_extended(tmp_path):
    """More episodes and more policies are added; finished ones are not driven again."""
    save(tmp_path / "model.zip", 0)
    for name in ("x.parquet", "x.csv"):
        output = ["--output", str(tmp_path / name)]
        assert evaluate(tmp_path, *output).exit_code == 0
        read = pd.read_parquet if name.endswith("parquet") else pd.read_csv
        before = read(tmp_path / name)
        again = evaluate(tmp_path, *output)
        assert "--resume extends it, --force overwrites it" in str(again.exception)
        more = ["--policy", "idle", "--episodes", "3", "--shield", "none,full", "--resume"]
        result = evaluate(tmp_path, *output, *more)
        assert result.exit_code == 0, result.output
        found = read(tmp_path / name)
        rows = found.groupby(["policy", "mode"], sort=False)["seed"].apply(list).to_dict()
        seeds = [100_000, 100_001, 100_002]
        assert rows == {(policy, mode): seeds for policy in ("model", "idle") for mode in ("none", "full")}
        kept = found[(found["policy"] == "model") & (found["mode"] == "none")].head(2).reset_index(drop=True)
        assert kept["latencies_ms"].astype(str).tolist() == before["latencies_ms"].astype(str).tolist()
        assert (
            kept.drop(columns="latencies_ms")
            .astype(str)
            .replace("None", "nan")
            .equals(before.drop(columns="latencies_ms").astype(str).replace("None", "nan"))
        )
        fewer = evaluate(tmp_path, *output, "--policy", "slower", "--resume")
        assert fewer.exit_code == 0, fewer.output
        assert len(read(tmp_path / name)) == len(found) + 2
        assert not Path(f"{tmp_path / name}.episodes").exists()


def test_a_table_that_does_not_say_how_it_was_made_is_not_extended(tmp_path):
    save(tmp_path / "model.zip", 0)
    output = ["--output", str(tmp_path / "x.csv")]
    assert evaluate(tmp_path, *output).exit_code == 0
    (tmp_path / "x.json").unlink()
    result = evaluate(tmp_path, *output, "--resume")
    assert "x.csv does not say how it was made" in str(result.exception)

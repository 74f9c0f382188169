"""Safety monitor: shapes, checkpoints, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from dynamics.errors import ConfigError, ModelError
from dynamics.world_model.monitor import MonitorConfig, SafetyMonitor, load_monitor, save_monitor
from dynamics.world_model.view import FrameView

SMALL = MonitorConfig(depth=4, embedding=8, hidden=8)


def frames(n=3, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (n, 5, 64, 64), dtype=np.uint8)


def test_a_saved_monitor_has_the_same_probabilities(tmp_path):
    monitor = SafetyMonitor(SMALL).with_config(threshold=0.2, slope=1.5, offset=-0.3)
    save_monitor(monitor, tmp_path, {"states": [1]})
    read = load_monitor(tmp_path)
    assert read.config == monitor.config
    np.testing.assert_array_equal(read.probabilities(frames()), monitor.probabilities(frames()))


def test_weights_follow_from_the_seed():
    one, two, other = (SafetyMonitor(MonitorConfig(depth=4, embedding=8, hidden=8, seed=s)) for s in (3, 3, 4))
    assert torch.equal(one.head[0].weight, two.head[0].weight)
    assert not torch.equal(one.head[0].weight, other.head[0].weight)


def test_slope_and_offset_scale_the_logits():
    monitor = SafetyMonitor(SMALL)
    plain = monitor.probabilities(frames())
    scaled = monitor.with_config(slope=2.0, offset=1.0).probabilities(frames())
    np.testing.assert_allclose(np.log(scaled / (1 - scaled)), 2 * np.log(plain / (1 - plain)) + 1, atol=1e-4)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"actions": 0}, "actions of a safety monitor is a positive whole number, not 0"),
        ({"threshold": 1.0}, "threshold of a safety monitor is between 0 and 1, not 1.0"),
        ({"slope": -1.0}, "slope and offset of a safety monitor are finite"),
        ({"view": FrameView(size=40)}, "multiple of 16, not 40"),
    ],
)
def test_configurations_that_make_no_monitor_are_refused(given, message):
    with pytest.raises(ConfigError, match=message):
        MonitorConfig(**given)


@pytest.mark.parametrize("seen", [frames().astype(float), frames()[:, :4], frames()[0]])
def test_frames_of_another_form_are_refused(seen):
    with pytest.raises(ConfigError, match="reads uint8 frames of shape"):
        SafetyMonitor(SMALL).probabilities(seen)


def test_a_folder_without_a_monitor_is_refused(tmp_path):
    save_monitor(SafetyMonitor(SMALL), tmp_path)
    config = (tmp_path / "config.json").read_text()
    (tmp_path / "config.json").write_text(config.replace('"safety_monitor"', '"another"'))
    with pytest.raises(ModelError, match="holds no safety monitor"):
        load_monitor(tmp_path)

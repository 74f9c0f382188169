"""The demo of learning to park writes its files, and its film shows parking."""

import pytest
from PIL import Image

from evaluation.commands.cem_demo import cem_demo


@pytest.mark.slow
def test_the_demo_parks_and_writes_its_files(tmp_path):
    said: list[str] = []
    film, picture = cem_demo(tmp_path / "deep", said.append)
    assert sum("parked after" in line for line in said) >= 4
    assert Image.open(film).n_frames > 50
    assert Image.open(picture).width > 300

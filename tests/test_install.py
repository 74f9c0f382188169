"""An installed package is visible to type checkers of other projects."""

from __future__ import annotations

import subprocess
import sys

import pytest

USER = """
from shield import Shield, ShieldConfig
braking: str = ShieldConfig().braking
"""


@pytest.mark.slow
def test_type_checkers_find_the_packages_from_elsewhere(tmp_path):
    (tmp_path / "user.py").write_text(USER, encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--ignore-missing-imports",
        "--cache-dir",
        str(tmp_path / "cache"),
        "user.py",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert 'expression has type "float", variable has type "str"' in done.stdout, done.stdout + done.stderr

"""Writer of a replay as one HTML file without dependencies: no network, no library, no package."""

from __future__ import annotations

import html
from importlib.resources import files
from pathlib import Path

from evaluation.replay.record import Replay
from shield.errors import ConfigError

__all__ = ["page_path", "to_html", "write_page"]

_SCRIPTS = ("data.js", "scene.js", "timeline.js", "controls.js")
"""Scripts of the page, in the order of execution."""


def to_html(replay: Replay) -> str:
    """The page, with the JSON of `Replay.to_json` in a script element of type application/json."""
    folder = files("evaluation.replay").joinpath("page")

    def part(name: str) -> str:
        return folder.joinpath(name).read_text(encoding="utf-8")

    about = replay.about
    title = f"{about['setting']}, {about['policy']}, seed {about['seed']}: replay"
    filled = {
        "@TITLE@": html.escape(title),
        "@STYLE@": part("replay.css"),
        # The end tag is the only markup inside a script element, so the data may not contain "<".
        "@DATA@": replay.to_json().replace("<", "\\u003c"),
        "@SCRIPT@": "\n".join(part(name) for name in _SCRIPTS),
    }
    # Fill in one placeholder after another, so that inserted text is never searched for placeholders.
    parts: list[str] = []
    left = part("replay.html")
    for mark, text in filled.items():
        before, _, left = left.partition(mark)
        parts += [before, text]
    return "".join([*parts, left])


def page_path(path: Path) -> Path:
    """The path of a page.

    Raises
    ------
    ConfigError
        If it is no .html.
    """
    if path.suffix not in (".html", ".htm"):
        raise ConfigError(f"a replay page is written as .html, not {path.suffix or 'without an ending'!r}")
    return path


def write_page(replay: Replay, path: Path) -> Path:
    """Write the page, and create its folder; returns the path."""
    path = page_path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(to_html(replay), encoding="utf-8")
    return path

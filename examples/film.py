"""A film of a policy behind the shield, around one of its overrides: what was proposed, and what was done.

Takes 12 s on one core.
"""

import sys

from evaluation.report.video import film_override

policy = sys.argv[1] if len(sys.argv) > 1 else "faster"  # a name, or the path of a model: my-model.zip
film = film_override("runs/film.gif", setting="highway-fast", policy=policy)
print(f"{film.path}: seed {film.seed}, {film.overrides} decisions overridden in {film.frames} frames")

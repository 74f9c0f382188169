"""Prior maps of environments in other processes: given by the user, or queried once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shield.environments import is_known
from shield.errors import ConfigError
from shield.perception.known import Known
from shield.perception.perceiving import PerceptionConfig
from shield.perception.unwrapping import check_wrappers

__all__ = ["prior_maps"]


def prior_maps(
    env: Any, known: Known | Sequence[Known] | None, frames: bool, perception: str | PerceptionConfig
) -> tuple[Known, ...]:
    """Prior map of each environment, if observations are the only other source; () if the environments are in this
    process.

    Parameters
    ----------
    env : the environment that the actions are for; None if there is nothing but `known`.
    known : prior maps given by the user. frames, perception : as of `Shield`.

    Raises
    ------
    ConfigError
        If frames of an environment in another process are to be supervised, or its state is to be read; or if the
        number of prior maps differs from that of the environments.
    """
    remote = env is not None and hasattr(env, "num_envs") and not getattr(env, "envs", None)
    if known is None and not (remote and perception != "simulator"):
        return ()
    if perception == "simulator":
        raise ConfigError('known is for Shield(..., frames=False, perception="observation", known=...)')
    if frames:
        alone = "pass frames=False, or " if known is not None or is_known(env) else ""
        raise ConfigError(
            f"the frames between two decisions are out of reach: {alone}put the shield inside, "
            "SubprocVecEnv([lambda: ShieldedEnv(gym.make(...))])"
        )
    if known is None:
        return Known.of(env)
    many = int(getattr(env, "num_envs", 1))
    each = (known,) * many if isinstance(known, Known) else tuple(known)
    if not each or (env is not None and len(each) != many):
        raise ConfigError(f"there are {many} environments, and {len(each)} are known")
    check_wrappers(env, ())
    return each

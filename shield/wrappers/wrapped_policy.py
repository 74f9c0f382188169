"""Attributes that `Shield` forwards to its policy, by name, so that a type checker and a user see which are missing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

from shield.errors import ConfigError

__all__ = ["WrappedPolicy"]

_TRAINING = (
    "{name}() trains the policy without the shield: Shield filters predict(), which training does not call. Train "
    "inside the shield: model.set_env(ShieldedEnv(env)) and model.learn(steps), or PPO('MlpPolicy', ShieldedEnv(env))"
)


class WrappedPolicy:
    """Attributes of an SB3 model that `evaluate_policy` and users read, forwarded to the wrapped policy.

    All others are attributes of `policy`: `shielded.policy.save(path)`.

    Attributes
    ----------
    policy : the wrapped policy, with SB3's `predict`.
    """

    policy: Any

    @property
    def observation_space(self) -> Any:
        """The policy's observation space; AttributeError if it has none."""
        return self._of_policy("observation_space")

    @property
    def action_space(self) -> Any:
        """The policy's action space; AttributeError if it has none."""
        return self._of_policy("action_space")

    @property
    def device(self) -> Any:
        """Device of the policy; AttributeError if it has none."""
        return self._of_policy("device")

    @property
    def n_envs(self) -> Any:
        """Number of environments of the model; AttributeError if it has none."""
        return self._of_policy("n_envs")

    @property
    def num_timesteps(self) -> Any:
        """Number of steps that the model has learned from; AttributeError if it has none."""
        return self._of_policy("num_timesteps")

    def get_env(self) -> Any:
        """The model's environment; AttributeError if it has no such method."""
        return self._of_policy("get_env")()

    def get_vec_normalize_env(self) -> Any:
        """The model's `VecNormalize`; AttributeError if it has no such method."""
        return self._of_policy("get_vec_normalize_env")()

    def learn(self, *args: Any, **kwargs: Any) -> NoReturn:
        """Refused: it would train the policy without the shield.

        Raises
        ------
        ConfigError
            Always, with the remedy.
        """
        raise ConfigError(_TRAINING.format(name="learn"))

    def train(self, *args: Any, **kwargs: Any) -> NoReturn:
        """Refused, as `learn` is.

        Raises
        ------
        ConfigError
            Always.
        """
        raise ConfigError(_TRAINING.format(name="train"))

    def _of_policy(self, name: str) -> Any:
        if not hasattr(self.policy, name):
            self._has_no(name)
        return getattr(self.policy, name)

    def _has_no(self, name: str) -> NoReturn:
        """Raise AttributeError, with the place of the attribute if the wrapped policy has it."""
        own = self.__dict__.get("policy")
        there = f"; the wrapped policy has it: .policy.{name}" if own is not None and hasattr(own, name) else ""
        raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}{there}", name=name, obj=self)

    if not TYPE_CHECKING:
        # Hidden from type checkers, which would otherwise accept every attribute.
        __getattr__ = _has_no

"""What `Shield` has of the policy that it wraps: by name, so that a type checker and a user see what it has not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

from shield.errors import ConfigError

__all__ = ["WrappedPolicy"]

_TRAINING = (
    "{name}() trains the policy without the shield: Shield filters predict(), which training does not call. Train "
    "inside the shield: model.set_env(ShieldedEnv(env)) and model.learn(steps), or PPO('MlpPolicy', ShieldedEnv(env))"
)


class WrappedPolicy:
    """Attributes that `evaluate_policy` and users read of an SB3 model, answered by the wrapped one.

    Anything else of the model is at `policy`: `shielded.policy.save(path)`.

    Attributes
    ----------
    policy : what is wrapped, with SB3's `predict`.
    """

    policy: Any

    @property
    def observation_space(self) -> Any:
        """The policy's observation space; AttributeError where it has none."""
        return self._of_policy("observation_space")

    @property
    def action_space(self) -> Any:
        """The policy's action space; AttributeError where it has none."""
        return self._of_policy("action_space")

    @property
    def device(self) -> Any:
        """Where the policy computes; AttributeError where it does not say."""
        return self._of_policy("device")

    @property
    def n_envs(self) -> Any:
        """For how many environments the model was made; AttributeError where it does not say."""
        return self._of_policy("n_envs")

    @property
    def num_timesteps(self) -> Any:
        """How many steps the model has learned from; AttributeError where it does not say."""
        return self._of_policy("num_timesteps")

    def get_env(self) -> Any:
        """The environment that the model carries; AttributeError where it carries none."""
        return self._of_policy("get_env")()

    def get_vec_normalize_env(self) -> Any:
        """The `VecNormalize` that the model carries; AttributeError where it has no such method."""
        return self._of_policy("get_vec_normalize_env")()

    def learn(self, *args: Any, **kwargs: Any) -> NoReturn:
        """Refused: it would train the policy without the shield.

        Raises
        ------
        ConfigError
            Always, with what to do instead.
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
        """Say where what a user looks for is."""
        own = self.__dict__.get("policy")
        there = f"; the wrapped policy has it: .policy.{name}" if own is not None and hasattr(own, name) else ""
        raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}{there}", name=name, obj=self)

    if not TYPE_CHECKING:
        # A type checker that knew of it would take every attribute for one that is there.
        __getattr__ = _has_no

"""GymnasiumSimulator: any Gymnasium environment as a Simulator."""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.metadata import distributions
from numbers import Integral
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from pytest_dura.adapters.plain_signals import PlainSignals
from pytest_dura.core.errors import ActionError, ConfigurationError, shorten
from pytest_dura.core.percepts import NOTHING, Percept, sealed
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.seeding import watch_draws
from pytest_dura.core.simulator import Scene
from pytest_dura.core.state import Tick
from pytest_dura.core.trust import check_import, check_names, import_checked

if TYPE_CHECKING:
    import gymnasium


def _to_action(space: gymnasium.Space[Any], action: Any) -> Any:
    """Return the action as an element of the space.

    Raises:
        ActionError: If it is not one, with the expected form.
    """
    from gymnasium.spaces import Box, Discrete

    if action is None:
        raise ActionError(f"the proposal holds no action (None); expected {space}")
    if isinstance(space, Discrete):
        return _choice(int(space.start), int(space.n), action)
    if isinstance(space, Box):
        return _vector(space, action)
    if not space.contains(action):
        raise ActionError(f"{shorten(action)} is not an element of {space}")
    return action


def _default_action(space: gymnasium.Space[Any]) -> Any:
    """Return the first choice of a discrete space, or the point of a box next to zero.

    Returns:
        ``None``, which is no action, for any other space.
    """
    from gymnasium.spaces import Box, Discrete

    if isinstance(space, Discrete):
        return int(space.start)
    if isinstance(space, Box):
        return np.clip(np.zeros(space.shape, dtype=space.dtype), space.low, space.high)
    return None


def _action_text(action: Any) -> str:
    """Format the action's numbers, the same text in every process."""
    if isinstance(action, np.ndarray):
        return "[" + ", ".join(f"{value:.6g}" for value in action.ravel().tolist()) + "]"
    return str(action)


def _choice(start: int, count: int, action: Any) -> int:
    whole = isinstance(action, Integral) and not isinstance(action, (bool, np.bool_))
    if not whole or not start <= int(action) < start + count:
        raise ActionError(
            f"{shorten(action)} is not an action; expected a whole number"
            f" from {start} to {start + count - 1}"
        )
    return int(action)


def _vector(space: Any, action: Any) -> Any:
    expected = f"{space.shape} numbers from {_bounds(space.low)} to {_bounds(space.high)}"
    try:
        vector = np.array(action, dtype=space.dtype)
    except (TypeError, ValueError):
        raise ActionError(f"{shorten(action)} is not an action; expected {expected}") from None
    if vector.shape != space.shape:
        raise ActionError(f"the action has the shape {vector.shape}; expected {expected}")
    if np.isnan(vector).any():
        raise ActionError(f"the action holds NaN; expected {expected}")
    if (vector < space.low).any() or (vector > space.high).any():
        raise ActionError(f"{_action_text(vector)} is out of bounds; expected {expected}")
    vector.flags.writeable = False
    return vector


def _bounds(values: Any) -> str:
    first = values.ravel()[0] if values.size else 0
    return f"{first:g}" if (values == first).all() else _action_text(values)


Signals = Callable[[Any, Mapping[str, Any], float], Mapping[str, float]]
Sensors = Callable[[Any, Mapping[str, Any]], Mapping[str, Any]]
Goal = Callable[[Any, Mapping[str, Any], float], bool]
Critical = Callable[[Any, Mapping[str, Any], float], "str | None"]
Scenes = Callable[[Sequence[Tick], Sequence[Percept]], "Scene | None"]

_TERMINATED = "the environment has terminated"


class GymnasiumSimulator(PlainSignals):
    """Simulates by a Gymnasium environment; callables give ground truth and sensor channels.

    Every callable may be given as an import path ``package.module:name``, so that a RoleSpec
    holds plain data. ``scenario["world"]`` goes to the environment's ``reset`` as ``options``. The
    time limit with which an environment is registered is left out: the length of an episode is the
    scenario's. An environment that truncates an episode all the same ends it, as ``truncated``,
    which is judged as a time limit; where it does so for another reason, such as a place that it
    cannot leave, ``critical`` has to say so.

    Args:
        env: A Gymnasium id, or an import path of an environment class or factory.
        params: Keyword arguments for it. ``render_mode="rgb_array"`` makes ``render`` work.
        time_step: Simulated seconds that one step of the environment takes.
        signals: ``(observation, info, reward)`` to the ground-truth signals: the same names at
            every tick, finite numbers.
        sensors: ``(observation, info)`` to the sensor channels. Arrays, lists and dictionaries
            in them become read-only copies.
        goal: ``(observation, info, reward)`` to whether the task is done; never by default.
        critical: ``(observation, info, reward)`` to why the episode cannot go on, or ``None``. An
            environment that terminates without having reached the goal is critical anyway.
        scene: ``(ticks, percepts)`` to the scene that the report's player shows; none by default.
            ``tick.truth`` has the signals, a percept the sensor channels.
        fallback: The action where no role proposes a valid one; by default the first of a discrete
            space, the point of a box next to zero.
        time_step_attribute: Attribute of the unwrapped environment that holds its time step
            (``tau`` of CartPole). Without it no other time step can be chosen.

    Raises:
        ConfigurationError: If a path cannot be imported.
    """

    def __init__(
        self,
        env: str,
        params: Mapping[str, Any] = NOTHING,
        *,
        time_step: float,
        signals: Signals | str,
        sensors: Sensors | str,
        goal: Goal | str | None = None,
        critical: Critical | str | None = None,
        scene: Scenes | str | None = None,
        fallback: Any = None,
        time_step_attribute: str | None = None,
    ) -> None:
        self._fixed_step: float | None = None
        self.set_time_step(time_step)
        self._fixed_step = None if time_step_attribute else time_step
        self._time_step_attribute = time_step_attribute
        self._env_name, self._params = env, dict(params)
        self._signals: Signals = _callable(signals)
        self._sensors: Sensors = _callable(sensors)
        self._goal: Goal | None = None if goal is None else _callable(goal)
        self._critical: Critical | None = None if critical is None else _callable(critical)
        self._scene: Scenes | None = None if scene is None else _callable(scene)
        self._fallback = fallback
        self._env: gymnasium.Env[Any, Any] | None = None
        self._index = 0

    @property
    def env(self) -> gymnasium.Env[Any, Any]:
        """The environment, made at first use.

        Raises:
            ConfigurationError: If it cannot be made.
        """
        if self._env is None:
            self._env = _make(self._env_name, self._params)
        return self._env

    def set_time_step(self, seconds: float) -> None:
        """Set the time step, if ``time_step_attribute`` allows another one.

        Raises:
            ConfigurationError: If it does not, and for a number that is not positive.
        """
        if self._fixed_step is not None and 0.0 < seconds != self._fixed_step:
            raise ConfigurationError(
                f"one step of {self._env_name} takes {self._fixed_step:g} s",
                key="time_step",
                found=seconds,
                expected=f"{self._fixed_step:g}",
                remedy="give the scenario this time step, or name the time_step_attribute",
            )
        super().set_time_step(seconds)

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Reset the environment with this seed and ``scenario["world"]`` as its options."""
        if self._time_step_attribute is not None:
            self._set_attribute(self._time_step_attribute)
        self.fallback_action()  # refuses an invalid one before the first step
        self._index = 0
        options = dict(scenario.get("world") or {})
        check_names(options, _packages(type(self.env.unwrapped)))
        observation, info = self.env.reset(seed=seed, options=options or None)
        own = getattr(
            self.env.unwrapped, "_np_random", None
        )  # its property would create a generator
        if own is not None:
            from gymnasium.utils.seeding import np_random

            watch_draws(own, np_random(seed)[0])
        return self._tick(observation, info, 0.0, terminated=False, truncated=False)

    def step(self, action: Any) -> Tick:
        """Step the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._index += 1
        return self._tick(
            observation, info, float(reward), terminated=terminated, truncated=truncated
        )

    def scene(self, ticks: Sequence[Tick], percepts: Sequence[Percept]) -> Scene | None:
        """Return the result of the ``scene`` callable."""
        return None if self._scene is None else self._scene(ticks, percepts)

    def check_action(self, action: Any) -> Any:
        """Return the action as an element of the action space; arrays become read-only copies.

        Raises:
            ActionError: If it is not one, with the expected form.
        """
        return _to_action(self.env.action_space, action)

    def fallback_action(self) -> Any:
        """Return the configured fallback, or the default one.

        Raises:
            ConfigurationError: If the environment does not accept it.
        """
        space = self.env.action_space
        fallback = _default_action(space) if self._fallback is None else self._fallback
        try:
            return _to_action(space, fallback)
        except ActionError as error:
            raise ConfigurationError(
                f"{self._env_name} cannot fall back to that: {error}",
                key="fallback",
                found=fallback,
                expected=f"an element of {space}",
                remedy="configure a fallback action",
            ) from None

    def describe_action(self, action: Any) -> str:
        """Format the action's numbers."""
        return _action_text(action)

    def render(self) -> NDArray[np.uint8]:
        """Render the environment, if its render mode is ``rgb_array``."""
        if self.env.render_mode != "rgb_array":
            raise NotImplementedError("pass params={'render_mode': 'rgb_array'} to render")
        return np.asarray(self.env.render(), dtype=np.uint8)

    def snapshot(self) -> object:
        """Copy the environment deeply, without the objects of pygame."""
        return _copy_of(self.env), self._index

    def restore(self, snapshot: object) -> None:
        """Return to a snapshot."""
        env, self._index = cast("tuple[gymnasium.Env[Any, Any], int]", snapshot)
        self._env = _copy_of(env)

    def close(self) -> None:
        """Close the environment."""
        if self._env is not None:
            self._env.close()
            self._env = None

    def _tick(
        self, observation: Any, info: Mapping[str, Any], reward: float, *, terminated: bool,
        truncated: bool,
    ) -> Tick:  # fmt: skip
        values = self._signals(observation, info, reward)
        goal = self._goal is not None and bool(self._goal(observation, info, reward))
        critical = None if self._critical is None else self._critical(observation, info, reward)
        if critical is None and terminated and not goal:
            critical = _TERMINATED
        return Tick(
            index=self._index,
            time=self._index * self.time_step,
            truth=MappingProxyType({name: float(value) for name, value in values.items()}),
            channels=read_only(self._sensors(observation, info)),
            goal=goal,
            critical=critical,
            truncated=bool(truncated or terminated),  # either way `step` may not be called again
        )

    def _set_attribute(self, name: str) -> None:
        if not hasattr(self.env.unwrapped, name):
            raise ConfigurationError(
                f"{self._env_name} has no attribute {name!r} that holds its time step",
                key="time_step_attribute",
                found=name,
                remedy="name the attribute, or leave it out",
            )
        setattr(self.env.unwrapped, name, self.time_step)


def read_only(value: Any) -> Any:
    """Copy plain data and arrays to read-only ones; return other values as they are."""
    if isinstance(value, np.ndarray):
        return sealed(value)
    if isinstance(value, Mapping):
        return MappingProxyType({key: read_only(inner) for key, inner in value.items()})
    if type(value) in (list, tuple):
        return tuple(map(read_only, value))
    return value


def _copy_of(env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    # Clocks and windows cannot be copied; environments create missing ones.
    memo: dict[int, Any] = {
        id(part): None
        for part in vars(env.unwrapped).values()
        if type(part).__module__.partition(".")[0] == "pygame"
    }
    return copy.deepcopy(env, memo)


def _callable(value: Callable[..., Any] | str) -> Any:
    return RoleSpec(value).function() if isinstance(value, str) else value


@cache
def _environment_packages() -> frozenset[str]:
    """Packages that offer environments to Gymnasium by an entry point, and its own."""
    points = (point for installed in distributions() for point in installed.entry_points)
    offered = {p.module.partition(".")[0] for p in points if p.group.startswith("gymnasium.envs")}
    return frozenset({"gymnasium", *offered})


def _packages(creator: object = None) -> frozenset[str]:
    """Packages whose modules a configuration may name.

    Args:
        creator: Class or factory of the environment, whose package and those of its bases count.
    """
    kinds = () if creator is None else getattr(creator, "__mro__", (creator,))
    own = {str(getattr(kind, "__module__", "")).partition(".")[0] for kind in kinds}
    return _environment_packages() | (own - {"", "builtins"})


def _make(name: str, params: Mapping[str, Any]) -> gymnasium.Env[Any, Any]:
    import gymnasium
    from gymnasium.envs.registration import load_env_creator

    # "module:Name" is ours; "module:Name-v0" is Gymnasium's own way to import before making.
    if ":" in name and "-" not in name.partition(":")[2]:
        check_names(name, _packages())
        spec = RoleSpec(name, params)
        check_names(params, _packages(spec.factory(gymnasium.Env)))
        env = spec.create(gymnasium.Env)
    else:
        module, colon, known_id = name.rpartition(":")
        check_import(name if colon else "gymnasium")
        if module not in sys.modules:  # importing it again would run nothing
            check_names(name, _packages())
        try:
            if colon:
                import_checked(module)
            registered = gymnasium.registry.get(known_id)
            creator: Any = None if registered is None else registered.entry_point
            if isinstance(creator, str):
                creator = load_env_creator(creator)
            check_names(params, _packages(creator))
            env = gymnasium.make(
                name, **{"max_episode_steps": -1, "disable_env_checker": True, **params}
            )
        except (gymnasium.error.Error, TypeError, ImportError) as error:
            raise ConfigurationError(
                f"Gymnasium cannot make {name!r}: {error}",
                key="env",
                found=name,
                expected="a registered id, or an import path package.module:Name",
                remedy="check the id, and that the package which registers it is imported",
            ) from error
    if not isinstance(env, gymnasium.Env):
        raise ConfigurationError(
            f"{name!r} is not a Gymnasium environment",
            key="env",
            found=type(env).__name__,
            expected="a gymnasium.Env",
        )
    return env

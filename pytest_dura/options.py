"""Options: tables of which each row is an option of pytest's command line, a setting, or both.

A row is all that an option needs but its use: command line and ini file, help, the reference page,
commands that run something again, the workers of pytest-xdist, and what shards have to have in
common are made from the rows. The package has one such table, and each guest may bring another.
Every pytest run loads this module, so that it imports nothing of pytest or of the package.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Generic,
    Literal,
    NamedTuple,
    TypeVar,
    cast,
    overload,
)

if TYPE_CHECKING:
    from pytest_dura.core.errors import ConfigurationError

T = TypeVar("T")
Command = Literal["rerun", "replay"]
"""A printed command that runs an item, or an episode, again."""
WORKER_KEY = "dura_options"
"""Key of what a worker of pytest-xdist is sent: paths of the controller, by options."""
_EMPTY_SETTINGS: Mapping[str, Any] = {"string": "", "bool": False, "args": [], "paths": []}


class Setting(NamedTuple):
    """An option in a session, before it is read.

    Args:
        key: The option, or ``ini`` and the setting, for messages.
        given: Text, list or truth value; ``None`` where nothing was given.
        default: Text that holds where nothing was given.
        config: The session's configuration.
    """

    key: str
    given: Any
    default: str | None
    config: Any

    @property
    def value(self) -> Any:
        """What was given, or the default."""
        return self.default if self.given is None else self.given

    @property
    def path(self) -> Path:
        """Path as it was given, from where pytest was started; the default is in the root."""
        place: Path = self.config.invocation_params.dir if self.given else self.config.rootpath
        return place / str(self.given or self.default)

    def other(self, option: str) -> Any:
        """Return what was given of another option."""
        return self.config.getoption(option, None)


def unusable(problem: str, **places: Any) -> ConfigurationError:
    """Make the error of a value; every pytest run loads this module, and few raise one."""
    from pytest_dura.core.errors import ConfigurationError

    return ConfigurationError(problem, **places)


def as_given(setting: Setting) -> Any:
    """Return the value as it is."""
    return setting.value


def switch(setting: Setting) -> bool:
    """Return whether a switch was given."""
    return bool(setting.given)


def texts(setting: Setting) -> tuple[str, ...]:
    """Return the values of a repeatable option."""
    return tuple(setting.value or ())


def whole_number(at_least: int) -> Callable[[Setting], int]:
    """Make the reader of a whole number."""

    def read(setting: Setting) -> int:
        option = setting.key
        try:
            number = int(str(setting.value))
        except ValueError:
            number = at_least - 1
        if number < at_least:
            raise unusable(
                f"{option} takes a whole number",
                key=option,
                found=setting.value,
                expected=f"a whole number of at least {at_least}",
                remedy=f"for example {option}={max(at_least, 10)}",
            )
        return number

    return read


def existing_paths(setting: Setting) -> tuple[Path, ...]:
    """Read directories and files of scenarios and requirements, each of which has to exist."""
    paths = [setting.config.invocation_params.dir / path for path in setting.given or ()]
    if setting.default is not None and not paths and setting.path.is_dir():
        paths.append(setting.path)
    for path in paths:
        if not path.exists():
            raise unusable(
                "there is no such directory",
                key=setting.key,
                found=str(path),
                expected="a directory with scenario or requirement files",
                remedy="check the spelling; the path is relative to where pytest was started",
            )
    return tuple(paths)


@dataclass(repr=False, eq=False)  # each generated method costs every pytest run time
class Option(Generic[T]):
    """Row of the table; as an attribute of its table, the checked value of the session.

    An option without ``metavar`` and ``choices`` is a switch. The flag counts before the setting.

    Args:
        flag: The option of the command line, if it has one.
        help: What it does, without the default.
        read: Checks the value; not called where nothing is given and there is no default.
        ini: The setting in pytest's ini file, if it has one.
        ini_type: Type of the setting, as pytest calls it.
        default: What holds where nothing is given, as it would be typed, or what returns it.
        default_note: What the help says after the default.
        metavar: How the help shows its value.
        choices: Values that may be given.
        switch_values: Values that a switch may be given, as in ``--switch=value``. It takes no
            argument that follows it, which a path would be.
        repeatable: Whether it may be given several times.
        example: A value of it.
        details: What the reference page says besides, in Markdown.
        activates: Whether a session with it leaves evidence, whatever its tests are.
        brings_cases: Whether it names scenarios whose cases become items.
        repeated_in: Printed commands that repeat it.
        same_in_shards: Whether shards of a session need the same value. Not those that choose
            what is planned, which is compared, or where it goes, or stand in the record.
        no_shard: Why it excludes ``--dura-shard``, if it does.
        no_shard_for: The value that does; by default any.
        changes_episodes: Whether an episode of the same case and run is another one with it, and
            is not taken over by a session that goes on with another value.
        sent_to_workers: Whether a worker of pytest-xdist takes the path that the controller has.
    """

    flag: str | None
    help: str
    read: Callable[[Setting], T]
    ini: str | None = None
    ini_type: Literal["string", "bool", "args", "paths"] = "string"
    default: str | Callable[[], str] | None = None
    default_note: str = ""
    metavar: str | None = None
    choices: tuple[str, ...] = ()
    switch_values: tuple[str, ...] = ()
    repeatable: bool = False
    example: str | None = None
    details: str = ""
    activates: bool = False
    brings_cases: bool = False
    repeated_in: tuple[Command, ...] = ()
    same_in_shards: bool = True
    no_shard: str = ""
    no_shard_for: str | None = None
    changes_episodes: bool = False
    sent_to_workers: bool = False
    name: str = ""
    """Attribute of its table."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, options: None, owner: type) -> Option[T]: ...
    @overload
    def __get__(self, options: OptionTable, owner: type) -> T: ...
    def __get__(self, options: OptionTable | None, owner: type) -> Option[T] | T:
        if options is None:
            return self
        setting = self.setting(options.config)
        value = self.read(setting) if self._is_read(setting) else cast("T", None)
        vars(options)[self.name] = value  # read once: from now on the attribute is the value
        return value

    @property
    def key(self) -> str:
        """Its name in messages."""
        return self.flag or f"ini {self.ini}"

    @property
    def is_switch(self) -> bool:
        """Whether it takes no value on the command line."""
        return self.metavar is None and not self.choices

    @property
    def known_default(self) -> str | None:
        """What holds where nothing is given; ``None`` for nothing."""
        return self.default() if callable(self.default) else self.default

    @property
    def shown_default(self) -> str:
        """Default with its note; empty without any."""
        default = self.known_default
        return "" if default is None else default + self.default_note

    @property
    def full_help(self) -> str:
        """Help with the default."""
        default = f" (default: {self.shown_default})" if self.known_default is not None else ""
        return self.help + (" (repeatable)" if self.repeatable else "") + default

    def declare(self, parser: Any, group: Any) -> None:
        """Declare the flag and the setting."""
        if self.flag is not None:
            more: dict[str, Any] = {"action": "store_true"}
            if self.switch_values:
                # An optional value would swallow the path behind the switch.
                more = {"dest": self.flag.strip("-").replace("-", "_"), "action": "store_const"}
                for value in self.switch_values:
                    # The help of the switch names its values.
                    name = f"{self.flag}={value}"
                    group.addoption(name, help=argparse.SUPPRESS, const=value, **more)
                more["const"] = True
            if not self.is_switch:
                more = {"metavar": self.metavar, "choices": self.choices or None}
            if self.repeatable:
                more = {"action": "append", "default": [], "metavar": self.metavar}
            group.addoption(self.flag, help=self.full_help, **more)
        if self.ini is not None:
            empty = _EMPTY_SETTINGS[self.ini_type]
            parser.addini(self.ini, self.full_help, type=self.ini_type, default=empty)

    def typed(self, config: Any) -> Any:
        """Return what the command line gives; ``None`` for nothing."""
        value = None if self.flag is None else config.getoption(self.flag)
        return None if value in (False, []) else value

    def given(self, config: Any) -> Any:
        """Return what the command line gives, or else the ini file; ``None`` for nothing."""
        typed = self.typed(config)
        if typed is not None or self.ini is None:
            return typed
        setting = config.getini(self.ini)
        return None if setting == _EMPTY_SETTINGS[self.ini_type] else setting

    def setting(self, config: Any) -> Setting:
        """Return the option as it is set in a session; a worker's as the controller sent it."""
        sent: Mapping[str, Any] = getattr(config, "workerinput", {}).get(WORKER_KEY, {})
        return Setting(self.key, sent.get(self.key, self.given(config)), self.known_default, config)

    def excludes_shard(self, config: Any) -> bool:
        """Whether the session can be no shard."""
        given = self.given(config)
        return bool(self.no_shard and given is not None and self.no_shard_for in (None, given))

    def _is_read(self, setting: Setting) -> bool:
        """Whether there is a value, or what nothing means is the reader's to say."""
        return setting.value is not None or self.is_switch or self.repeatable


class OptionTable:
    """A table of options, and the checked options of a session as its attributes.

    Args:
        config: The session's configuration.

    Raises:
        ConfigurationError: For a value that cannot be used.
    """

    title: ClassVar[str] = ""
    """Heading of its options in ``--help``."""

    def __init__(self, config: Any) -> None:
        self.config = config
        for row in self.rows():
            getattr(self, row.name)

    @classmethod
    def rows(cls) -> tuple[Option[Any], ...]:
        """List the rows of the table."""
        return tuple(row for row in vars(cls).values() if isinstance(row, Option))

    def for_workers(self) -> Iterator[tuple[str, str]]:
        """Yield the options that are paths of the controller, as its workers take them."""
        for row in self.rows():
            path = getattr(self, row.name) if row.sent_to_workers else None
            if path is not None:
                yield row.key, str(path.absolute())

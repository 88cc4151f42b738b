"""`ClassRegistry`: classes that settings name, such as ``algorithm.kind=ppo`` or ``network.kind=my_package.nets:Mine``.

A registry neither imports torch nor a user's module. It names the package's classes as text, plugins add their own, and
``module:Class`` is found only in a module that is imported already (`skatemount.config.plugins` decides about that).
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import math
import re
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from skatemount.utils.errors import ConfigError, reason

_CLASS = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")
C = TypeVar("C", bound=type)


class ClassRegistry:
    """Named classes of one kind.

    Args:
        kind: What the classes are, for messages.
        entries: The package's classes as ``module:Class``, by name.
        methods: Methods that every class must have.
        base: Class to derive one's own from, for messages.
        given: Parameters of the constructor that the framework passes; all others are the user's.
        reserved: Names with a meaning of their own that no class may take.
    """

    def __init__(
        self,
        kind: str,
        entries: Mapping[str, str],
        methods: Sequence[str],
        base: str,
        given: Sequence[str] = (),
        reserved: Sequence[str] = (),
    ) -> None:
        self.kind = kind
        self._entries: dict[str, str | type] = dict(entries)
        self._methods, self._base = tuple(methods), base
        self._given, self._reserved = frozenset(given), tuple(reserved)

    def register(self, name: str) -> Callable[[C], C]:
        """Return a decorator that registers a class.

        Args:
            name: Name of the class in the settings.

        Raises:
            ConfigError: The name is taken.
        """

        def add(cls: C) -> C:
            if name in self._reserved:
                raise ConfigError(f"{self.kind} {name!r} of {cls.__module__}: the settings give this name a meaning")
            if name in self._entries:
                raise ConfigError(
                    f"{self.kind} {name!r} is registered twice, by {self.module(name)} and by {cls.__module__}"
                )
            self._entries[name] = cls
            return cls

        return add

    def names(self) -> list[str]:
        """Return every registered name, sorted."""
        return sorted(self._entries)

    def module(self, name: str) -> str:
        """Return the name of the module that has a registered class."""
        entry = self._entries[name]
        return entry.partition(":")[0] if isinstance(entry, str) else entry.__module__

    def description(self, name: str) -> str:
        """Return the first line of the docstring of a registered class; "" without one."""
        lines = (inspect.getdoc(self.find(name, self.kind)) or "").splitlines()
        return lines[0] if lines else ""

    def snapshot(self) -> dict[str, str | type]:
        """Return the present entries, for `restore`."""
        return dict(self._entries)

    def restore(self, saved: dict[str, str | type]) -> None:
        """Go back to the entries of a snapshot."""
        self._entries = dict(saved)

    def check(self) -> None:
        """Raise `ConfigError` for a class of a plugin that cannot be used."""
        for name, entry in self._entries.items():
            if not isinstance(entry, str):
                self._check_class(entry, f"{self.kind} {name!r}")

    def check_name(self, name: str, setting: str) -> None:
        """Raise `ConfigError` for a name that is neither registered nor ``module:Class``.

        Args:
            name: The value of the setting.
            setting: The setting, for messages.
        """
        if name in self._entries or name in self._reserved or _CLASS.fullmatch(name):
            return
        if ":" in name:
            raise ConfigError(f"{setting}={name} must be module:Class, such as my_package.mine:MyClass")
        known = [*self._reserved, *self._entries]
        close = difflib.get_close_matches(name, known, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        raise ConfigError(f"{setting}={name} must be one of {', '.join(known)}, or module:Class of your own{hint}")

    def is_ready(self, name: str) -> bool:
        """Return whether the class of a name can be had without importing a module of the user's."""
        return name in self._entries or module_of(name) in sys.modules

    def find(self, name: str, setting: str) -> Any:
        """Return the class of a name; a module of the user's must be imported already.

        Args:
            name: The value of the setting.
            setting: The setting, for messages.

        Raises:
            ConfigError: There is no such class, its module is not imported, or it lacks a method.
        """
        entry = self._entries.get(name)
        where = f"{setting}={name}"
        if not isinstance(entry, type):
            self.check_name(name, setting)
            module, _, attribute = (entry or name).partition(":")
            if entry is not None:
                importlib.import_module(module)
            elif module not in sys.modules:
                raise ConfigError(not_imported(where, module))
            entry = getattr(sys.modules[module], attribute, None)
            if entry is None:
                raise ConfigError(f"{where}: {module} has no class {attribute}")
            if not isinstance(entry, type):
                raise ConfigError(f"{where}: {attribute} of {module} is a {type(entry).__name__}, a class is needed")
        self._check_class(entry, where)
        return entry

    def check_choice(self, name: str, params: Mapping[str, Any], group: str) -> None:
        """Check ``<group>.kind`` and ``<group>.params``, as far as that is possible without importing a module.

        Args:
            name: The kind.
            params: Parameters of the class, by name.
            group: Group of the settings, for messages.

        Raises:
            ConfigError: The kind cannot be used, or a parameter is unknown, missing or of the wrong type.
        """
        self.check_name(name, f"{group}.kind")
        builtin = isinstance(self._entries.get(name), str)
        if not self.is_ready(name) or (builtin and not params):
            # A class of the package needs no parameters, and torch takes seconds to import.
            return
        cls = self.find(name, f"{group}.kind")
        known = self.parameters(cls)
        title = f"{cls.__name__} of {cls.__module__}"
        for key, value in params.items():
            where = f"{group}.params.{key}={value}"
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f"; did you mean {close[0]}?" if close else f"; known: {', '.join(known) or 'none'}"
                raise ConfigError(f"{where}: {title} has no such parameter{hint}")
            check_value(value, known[key][0], where)
        for key, (_, required) in known.items():
            if required and key not in params:
                raise ConfigError(f"{group}.params.{key} is missing: {title} needs it")

    def parameters(self, cls: type) -> dict[str, tuple[Any, bool]]:
        """Return the user's parameters of a class: the type, or `inspect.Parameter.empty`, and whether it is required.

        Raises:
            ConfigError: A type cannot be read.
        """
        # mypy: "Accessing __init__ on an instance is unsound", but this is a class.
        constructor = cls.__init__  # type: ignore[misc]
        try:
            hints = get_type_hints(constructor)
        except NameError as error:
            raise ConfigError(f"{cls.__name__} of {cls.__module__}: {error} in its annotations") from error
        variadic = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        return {
            each.name: (hints.get(each.name, each.empty), each.default is each.empty)
            for each in list(inspect.signature(constructor).parameters.values())[1:]
            if each.name not in self._given and each.kind not in variadic
        }

    def _check_class(self, cls: type, where: str) -> None:
        methods = {name: getattr(cls, name, None) for name in self._methods}
        missing = [
            n for n, each in methods.items() if not callable(each) or getattr(each, "__isabstractmethod__", False)
        ]
        if missing:
            raise ConfigError(
                f"{where}: {cls.__name__} of {cls.__module__} lacks {', '.join(missing)}; see {self._base}"
            )
        if not cls.__module__.startswith("skatemount."):
            self._check_signatures(cls, where)

    def _check_signatures(self, cls: type, where: str) -> None:
        """Check that the methods of a user's class can be called as those of the base are."""
        module, _, name = self._base.rpartition(".")
        base = getattr(importlib.import_module(module), name) if module else None
        for method in self._methods:
            given = _given(getattr(base, method, None))
            if given is None:
                continue
            try:
                taken = inspect.signature(getattr(cls, method))
            except (TypeError, ValueError):  # it is not written in Python
                continue
            try:
                taken.bind(None, *given)
            except TypeError:
                found = f"{method}({', '.join(list(taken.parameters)[1:])})"
                raise ConfigError(
                    f"{where}: {cls.__name__} of {cls.__module__} has {found}; it must take ({', '.join(given)}); see "
                    f"{self._base}"
                ) from None


def _given(method: Any) -> list[str] | None:
    """Return the names of the arguments that a method of a base class is called with; None if they are not known."""
    if not getattr(method, "__module__", "").startswith("skatemount."):
        return None
    parameters = list(inspect.signature(method).parameters.values())[1:]
    plain = inspect.Parameter.POSITIONAL_OR_KEYWORD
    return [each.name for each in parameters] if all(each.kind is plain for each in parameters) else None


def made(cls: Callable[..., Any], where: str, *arguments: Any, **named: Any) -> Any:
    """Return an object of a class that settings name.

    Args:
        cls: The class.
        where: The setting with its value, for messages.
        *arguments: Arguments of the constructor.
        **named: Further ones.

    Raises:
        ConfigError: The constructor of one's own class raises an error; the message names the class and the line.
    """
    try:
        return cls(*arguments, **named)
    except (ConfigError, OSError):
        raise
    except Exception as error:
        own = not cls.__module__.startswith("skatemount.")
        if not own and not isinstance(error, TypeError | ValueError):
            raise
        raise ConfigError(f"{where}: {cls.__name__} of {cls.__module__} cannot be made: {reason(error)}") from error


def module_of(name: str) -> str:
    """Return the module of ``module:Class``; "" for a registered name."""
    module, colon, _ = name.partition(":")
    return module if colon else ""


def not_imported(where: str, module: str) -> str:
    """Return the error for a module that saved settings name and that is not imported."""
    return (
        f"{where}: {module} is imported by itself only for a run inside logger.root; repeat plugins=[{module}] if you "
        "trust it"
    )


def check_value(value: Any, kind: Any, where: str) -> None:
    """Raise `ConfigError` for a value that is not of a type.

    Args:
        value: A plain value, as YAML gives it.
        kind: ``int``, ``float``, ``bool``, ``str``, a list of one of them, ``Literal``, or a union; anything else is
            not checked.
        where: The setting with its value, for messages.
    """
    if not _fits(value, kind):
        raise ConfigError(f"{where} must be {_in_words(kind)}")


def _fits(value: Any, kind: Any) -> bool:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return value in arguments
    if origin in (Union, types.UnionType):
        return any(_fits(value, each) for each in arguments)
    if origin is list or kind is list:
        return isinstance(value, list) and all(_fits(each, kind) for kind in arguments for each in value)
    if kind in (int, float) and isinstance(value, bool):
        return False
    if kind is float:
        return isinstance(value, int | float) and math.isfinite(value)
    if kind in (Any, inspect.Parameter.empty) or not isinstance(kind, type):
        return True
    return isinstance(value, kind)


def _in_words(kind: Any) -> str:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return " or ".join(map(str, arguments))
    if origin in (Union, types.UnionType):
        return " or ".join(map(_in_words, arguments))
    if origin is list:
        return f"a list, each {_in_words(arguments[0])}"
    names = {int: "a whole number", float: "a finite number", bool: "true or false", str: "text", type(None): "null"}
    return names.get(kind, getattr(kind, "__name__", str(kind)))

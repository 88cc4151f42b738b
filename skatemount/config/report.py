"""Settings of `python -m skatemount.report`."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.config.files import choices, no_choice
from skatemount.utils.bounds import check_bounds, number
from skatemount.utils.errors import ConfigError

OWN = "own"
"""Name of the task that a run was trained in, among the suites."""


@dataclass
class PageConfig:
    """Content of the page that `python -m skatemount.report` writes.

    Attributes:
        suites: Suites to evaluate the policy in before the page is written; `OWN` is the task of its training. Null
            means `OWN` for one run and none for several.
        episodes: Episodes of each of them.
        results: Files that ``json=`` of `skatemount.evaluate` wrote, or folders of them, to show as well.
        films: Number of best and of worst episodes to film; 0 for none.
        film_width: Pixels of a film; its height is three quarters of it.
        megabytes: Size of all films in the page together; films that do not fit are left out.
    """

    suites: list[str] | None
    episodes: int = field(metadata=number(1, 100_000))
    results: list[str]
    films: int = field(metadata=number(1, 10, zero="none"))
    film_width: int = field(metadata=number(160, 1280, "pixels, a multiple of 8"))
    megabytes: float = field(metadata=number(0, 500, "MB"))

    def validate(self, where: str = "page") -> None:
        """Raise `ConfigError` for the first setting that cannot be used."""
        check_bounds(self, where)
        if self.film_width % 8:
            raise ConfigError(f"{where}.film_width={self.film_width} must be a multiple of 8 pixels")
        for name in self.suites or []:
            if name != OWN and name not in choices("suite"):
                known = [OWN, *choices("suite")]
                raise ConfigError(f"{where}.suites=[{','.join(self.suites or [])}]: {no_choice('suite', name, known)}")
            if (self.suites or []).count(name) > 1:
                raise ConfigError(f"{where}.suites: {name} is there twice")

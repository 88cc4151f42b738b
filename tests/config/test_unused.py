"""Settings that cannot matter beside others are refused in one line."""

from __future__ import annotations

import pytest
from composed import one_line

from skatemount.config import compose_program
from skatemount.config.unused import check_used
from skatemount.utils.errors import ConfigError

NATIVE = "with viewer=native: only the page has it; leave out one of the two"
TORCH = "with format=torch: only format=onnx has start states; leave out one of the two"
NO_STARTS = "with episodes=0: it is for start states, and there are none; leave out one of the two"

REFUSED = [
    ("evaluate", "switch_distance=0.6", "needs two policies, such as pipeline=gait+anywhere"),
    ("record", "switch_distance=0.6", "needs two policies"),
    ("play", "switch_distance=0.6", "needs two policies"),
    ("export", "switch_distance=0.6", "is for two policies, and an export is for one"),
    ("record", "failures=3 episode=5", "needs episodes=failed"),
    ("record", "failures=3 episodes=4", "needs episodes=failed"),
    ("record", "failures=3", "needs episodes=failed"),
    ("record", "searched=9 episode=5", "with episode=: nothing is looked for when the episodes are named"),
    ("record", "searched=9 episodes=[1,2]", "with episodes=: nothing is looked for"),
    ("record", "film.gif_width=320", "needs film.gif=true"),
    ("play", "port=9000 viewer=native", NATIVE),
    ("play", "host=0.0.0.0 viewer=native", NATIVE),
    ("play", "plain=true viewer=native", NATIVE),
    ("play", "open_browser=false viewer=native", NATIVE),
    ("export", "suite=far format=torch", TORCH),
    ("export", "episodes=10 format=torch", TORCH),
    ("export", "seed=1 format=torch", TORCH),
    ("export", "start.x=[0,1] format=torch", TORCH),
    ("export", "suite=far episodes=0", NO_STARTS),
    ("export", "start.x=[0,1] episodes=0", NO_STARTS),
    ("export", "board=mini episodes=0", NO_STARTS),
    ("report", "runs=[]", "names no run; give some, or leave it out"),
    ("report", "runs=[] paper=true", "names no run"),
    ("report", "run=", "names no run"),
    ("report", "against=", "names no run"),
    ("report", "page.episodes=64 sweep=s", "with sweep=s: nothing is evaluated; page.suites=[own] evaluates the task"),
    ("report", "page.episodes=64 runs=[a,b]", "with runs=: nothing is evaluated"),
    ("report", "page.episodes=64 page.suites=[]", "with page.suites=[]: nothing is evaluated"),
    ("report", "page.episodes=64 paper=true", "with paper=true: nothing is evaluated"),
    ("report", "board=mini paper=true", "with paper=true: nothing is evaluated"),
    ("report", "start.x=[0,1] sweep=s", "with sweep=s: nothing is evaluated"),
    ("report", "page.films=2 sweep=s page.suites=[far]", "with sweep=s: that page films no episodes"),
    ("report", "page.films=2 page.suites=[]", "with page.suites=[]: that page films no episodes"),
    ("report", "page.film_width=320 sweep=s", "with sweep=s: that page has no films"),
    ("report", "page.megabytes=5 paper=true", "with paper=true: that page has no films"),
    ("report", "page.film_width=320 page.films=0", "with page.films=0: nothing is filmed"),
]

TAKEN = [
    ("evaluate", "pipeline=gait+anywhere switch_distance=0.6 seed=3 physics.threads=1"),
    ("record", "episodes=failed failures=3 searched=9 film.gif=true film.gif_width=320"),
    ("record", "searched=9 film.gif=true"),
    ("play", "port=9000 plain=true open_browser=false viewer=auto"),
    ("play", "worlds=2 speed=0.5 viewer=native"),
    ("export", "suite=far episodes=10 seed=1"),
    ("export", "format=torch output=here"),
    ("export", "episodes=0 boards=one"),
    ("export", "episodes=0 seed=1 output=here physics.threads=1"),
    ("report", "page.episodes=64 page.films=1 page.film_width=320 page.megabytes=5"),
    ("report", "sweep=s page.suites=[own] page.episodes=64 page.films=0"),
    ("report", "paper=true page.films=0 physics.threads=1"),
    ("report", "sweep=s page.suites=[own] board=mini"),
    ("report", "paper=true page.films=1 seed=2"),
    ("report", "page.suites=[] page.megabytes=5"),
    ("train", "stage=balance hydra.verbose=true"),
]


@pytest.mark.parametrize(("program", "words", "expected"), REFUSED)
def test_a_setting_that_cannot_matter_is_refused(program: str, words: str, expected: str) -> None:
    overrides = words.split()
    config = compose_program(program, overrides)
    # Whatever the order.
    for given in (overrides, overrides[::-1]):
        with pytest.raises(ConfigError) as error:
            check_used(config, given)
        text = one_line(error)
        assert text.startswith(f"{overrides[0]} {expected}"), text


@pytest.mark.parametrize(("program", "words"), TAKEN)
def test_settings_that_matter_are_taken(program: str, words: str) -> None:
    overrides = words.split()
    check_used(compose_program(program, [each for each in overrides if "hydra" not in each]), overrides)

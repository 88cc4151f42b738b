"""Decorations warn once, and never end anything."""

from __future__ import annotations

import pytest

from skatemount.utils.decoration import Decoration


def test_the_first_error_is_a_warning_and_the_others_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    picture = Decoration("the picture")
    done = []
    for n in range(3):
        with picture:
            raise RuntimeError("no\ncolors")
        done.append(n)
    with picture:
        done.append(3)
    assert done == [0, 1, 2, 3] and picture.failed == 3
    assert capsys.readouterr().err == "warning: the picture failed, the rest goes on (RuntimeError: no colors)\n"


@pytest.mark.parametrize("request_to_end", [KeyboardInterrupt, SystemExit])
def test_a_request_to_end_passes(request_to_end: type[BaseException]) -> None:
    picture = Decoration("the picture")
    with pytest.raises(request_to_end), picture:
        raise request_to_end
    assert not picture.failed

"""Only TorchRL's warnings about its own classes are ignored."""

from __future__ import annotations

import warnings

import pytest

from skatemount.utils.quiet import ignore_torchrl_warnings


def test_other_warnings_are_still_shown() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ignore_torchrl_warnings()
        warnings.warn("Creating VanillaWeightUpdater which is deprecated", DeprecationWarning, stacklevel=1)
        with pytest.raises(DeprecationWarning, match="something else"):
            warnings.warn("something else is deprecated", DeprecationWarning, stacklevel=1)

import gc
import platform
import subprocess
import sys

import pytest

from skatemount.utils.memory import lasting_objects

# NumPy asks for memory as it is; torch wants it aligned, which fits only after neighbours have been freed too.
PAGE_FAULTS = """
import resource
import sys
import numpy as np
from skatemount.utils.memory import disable_malloc_trim

def fresh_array():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.empty(int(sys.argv[1]), np.uint8).fill(1)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

fresh_array()
without = fresh_array()
disable_malloc_trim()
fresh_array()
print(without, fresh_array())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc is told")
@pytest.mark.parametrize("size", [16 * 2**20, 256 * 2**20])
def test_memory_of_a_freed_array_is_the_next_ones_without_being_cleared_again(size: int) -> None:
    asked = [sys.executable, "-c", PAGE_FAULTS, str(size)]
    result = subprocess.run(asked, capture_output=True, text=True, check=True)
    without, kept = map(int, result.stdout.split())
    assert without > 0
    assert kept == 0


def test_what_is_made_to_last_is_not_looked_through_for_garbage():
    try:
        with lasting_objects():
            assert not gc.isenabled()
            made = [[]]
        assert gc.isenabled()
        assert not any(thing is made for thing in gc.get_objects())
    finally:
        gc.unfreeze()
    assert any(thing is made for thing in gc.get_objects())


def test_the_garbage_collector_is_on_again_after_an_import_that_fails():
    try:
        with pytest.raises(ImportError), lasting_objects():
            raise ImportError("no such module")
        assert gc.isenabled()
    finally:
        gc.unfreeze()


def test_a_garbage_collector_that_was_off_stays_off():
    gc.disable()
    try:
        with lasting_objects():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
        gc.unfreeze()

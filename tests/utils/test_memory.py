import platform
import subprocess
import sys

import pytest

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

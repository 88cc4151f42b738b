import subprocess
import sys
from pathlib import Path

import pytest

from skatemount.runs.lock import claimed
from skatemount.utils.errors import ConfigError

CLAIM = """
import sys
from pathlib import Path
from skatemount.runs.lock import claimed

with claimed(Path(sys.argv[1])):
    print("claimed", flush=True)
    sys.stdin.read()
"""


def test_a_run_is_trained_by_one_process_at_a_time(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", CLAIM, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None and other.stdout.readline() == "claimed\n"
        with pytest.raises(ConfigError) as error, claimed(tmp_path):
            pass
        text = str(error.value)
        assert str(tmp_path) in text and "another process" in text and "\n" not in text
        # Even a process that is killed leaves nothing behind that would keep others out.
        other.kill()
    for _ in range(2):
        with claimed(tmp_path):
            pass

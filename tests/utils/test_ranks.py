"""The environment of a process that torchrun starts; `training/test_distributed.py` has the rest of `ranks`."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from skatemount.utils.cores import available_cores
from skatemount.utils.errors import ConfigError
from skatemount.utils.ranks import launch

PACKAGE = Path(__file__).resolve().parents[2] / "skatemount"
SET = {
    "RANK": "5", "WORLD_SIZE": "8", "LOCAL_RANK": "1", "LOCAL_WORLD_SIZE": "4", "MASTER_ADDR": "node0",
    "TORCHELASTIC_RESTART_COUNT": "2", "TORCHELASTIC_RUN_ID": "a",
}  # fmt: skip


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in SET:
        monkeypatch.delenv(name, raising=False)


def test_a_process_that_torchrun_did_not_start_is_the_only_one() -> None:
    alone = launch()
    assert (alone.rank, alone.size, alone.local_rank, alone.local_size, alone.restarts) == (0, 1, 0, None, 0)
    assert not alone.is_rank


def test_a_process_knows_what_torchrun_told_it(monkeypatch: pytest.MonkeyPatch) -> None:
    cores = available_cores()
    for name, value in SET.items():
        monkeypatch.setenv(name, value)
    told = launch()
    assert (told.rank, told.size, told.local_rank, told.local_size, told.address) == (5, 8, 1, 4, "node0")
    assert (told.restarts, told.job) == (2, "a") and told.is_rank
    assert available_cores() == max(1, cores // 4)


@pytest.mark.parametrize("change", [{"WORLD_SIZE": "1"}, {"RANK": None}, {"MASTER_ADDR": None}])
def test_a_rank_needs_a_number_an_address_and_others(
    change: dict[str, str | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (SET | change).items():
        if value is not None:
            monkeypatch.setenv(name, value)
    assert not launch().is_rank


def test_a_variable_that_is_no_number_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "many")
    with pytest.raises(ConfigError) as error:
        launch()
    assert str(error.value) == "WORLD_SIZE=many in the environment must be a whole number, as torchrun sets it"


def strings(path: Path) -> set[Any]:
    """Return the texts in a file's code."""
    return {node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)}


def test_the_variables_are_read_in_one_place() -> None:
    reading = [path for path in PACKAGE.rglob("*.py") if not strings(path).isdisjoint(SET)]
    assert [path.name for path in reading] == ["ranks.py"]


def test_it_needs_no_torch() -> None:
    code = "import sys, skatemount.utils.ranks; print([m for m in ('torch', 'mujoco') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent)
    assert done.stdout.strip() == "[]", done.stderr

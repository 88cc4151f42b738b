"""A logger: one number a line, for a spreadsheet."""

from __future__ import annotations

from skatemount.runs.folder import RunFolder


class RewardCsv:
    """Writes the mean reward of every iteration to ``reward.csv`` in the run folder."""

    def __init__(self, run: RunFolder, resume_at: int | None = None) -> None:
        path = run.path / "reward.csv"
        rows = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        # What a run that resumes had written after its checkpoint happens again.
        kept = [row for row in rows if resume_at is not None and int(row.split(",")[0]) <= resume_at]
        path.write_text("".join(f"{row}\n" for row in kept), encoding="utf-8")
        self._file = path.open("a", encoding="utf-8")

    def log(self, metrics: dict[str, float], frames: int) -> None:
        """Write a line, if an episode has ended."""
        if "Train/mean_reward" in metrics:
            self._file.write(f"{frames},{metrics['Train/mean_reward']:.4f}\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

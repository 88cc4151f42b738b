"""Measure what the page of `play` costs: the program's share of a core, and pictures a second in a browser.

    python benchmarks/play_cost.py --seconds 20 checkpoint=pretrained:anywhere suite=approach-unfixed

The program runs at the usual speed. Chromium opens its page, without a GPU, so it draws on the CPU. Then the processor
time of the program is measured, with and without the open page. Needs the extra `play`, playwright and Chromium.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import chromium  # noqa: E402

PICTURES = """() => new Promise(done => {
  let pictures = 0; const start = performance.now();
  const next = () => { pictures++;
    const passed = performance.now() - start;
    passed > 5000 ? done(1000 * pictures / passed) : requestAnimationFrame(next); };
  next(); })"""


def processor_time(process: subprocess.Popen[str]) -> float:
    """Return the processor time of a process and its threads, s."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100


def share(process: subprocess.Popen[str], seconds: float) -> float:
    """Return the share of a core that a process takes in the coming seconds."""
    before, start = processor_time(process), time.perf_counter()
    time.sleep(seconds)
    return (processor_time(process) - before) / (time.perf_counter() - start)


def measure(settings: list[str], worlds: int, seconds: float) -> dict[str, float]:
    """Return what a page with a number of worlds costs."""
    command = [sys.executable, "-m", "skatemount.play", f"worlds={worlds}", "open_browser=false", "plain=true"]
    process = subprocess.Popen([*command, *settings], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        address = next(found[0] for line in process.stdout if (found := re.search(r"http://\S+", line)))
        time.sleep(3)
        closed = share(process, seconds)
        with chromium.launched() as browser:
            page = browser.new_page(viewport={"width": 1180, "height": 700})
            page.goto(address)
            page.wait_for_selector("#play-time", timeout=120_000)
            time.sleep(5)
            begun, start = float(page.inner_text("#play-time").split()[0]), time.perf_counter()
            opened = share(process, seconds)
            simulated = float(page.inner_text("#play-time").split()[0]) - begun
            speed = simulated / (time.perf_counter() - start)
            pictures = float(page.evaluate(PICTURES))
    finally:
        process.terminate()
        process.wait(30)
    return {"worlds": worlds, "closed": closed, "open": opened, "speed": speed, "pictures": pictures}


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 4])
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("settings", nargs="*", default=["checkpoint=pretrained:anywhere", "suite=approach-unfixed"])
    options = parser.parse_intermixed_args()
    rows = [measure(options.settings, worlds, options.seconds) for worlds in options.worlds]
    print("| worlds | share of a core, no page open | page open | simulated s in a second | pictures a second |")
    print("|---|---|---|---|---|")
    for row in rows:
        shares = f"{row['closed']:.2f} | {row['open']:.2f} | {row['speed']:.2f}"
        print(f"| {row['worlds']} | {shares} | {row['pictures']:.1f} |")
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

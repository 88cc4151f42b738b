"""Texts of the page, as HTML."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable

from skatemount.viewer.measures import End
from skatemount.viewer.poses import Foot, sensed_board
from skatemount.viewer.session import Session

_BOX = "font-size:12px;line-height:1.45;padding:0 12px 12px"
_RED = "color:#c0392b"


def status(session: Session, speed: float | None) -> str:
    """Return what is played and how it goes.

    Args:
        session: The session.
        speed: Simulated seconds in a second that are reached; None before it is known.
    """
    env, world = session.env, session.selected
    sim, episode = env.sim, env.episode
    x, y, z = sim.base_pos[world].tolist()
    bx, by, _ = sim.board_pos[world].tolist()
    elapsed = float(episode.step[world]) * env.mdp.context.control_step
    command = ", ".join(f"{value:.2f}" for value in episode.command[world].tolist())
    pace = "paused" if session.paused else "" if speed is None else f"{speed:.2f} of {session.speed:g} ×"
    state = env.mdp.definition.state_word if episode.mounted[world] else ""
    rows = {
        "policy": session.policy_name,
        "task": session.config_name,
        "success": str(session.tally),
        "speed": pace,
        "time": f"{session.time:.2f} s",
        "episode": f"{elapsed:.2f} of {env.task.config.episode_length:g} s {state}",
        "robot": f"{x:.4f} {y:.4f} {z:.4f} m",
        "board": f"{bx:.4f} {by:.4f} m, {'fixed' if sim.board_fixed[world] else 'free'}",
        "command": f"{command} (forward, left m/s; turn rad/s)",
    }
    if episode.ride_command is not None:
        _, ride_speed, curvature = episode.ride_command[world].tolist()
        rows["ride"] = f"{ride_speed:.2f} m/s, curvature {curvature:+.2f} 1/m (left is positive)"
    lines = [
        f"<tr><td style='color:#888;padding-right:8px'>{name}</td><td id='play-{name}'>{html.escape(value)}</td></tr>"
        for name, value in rows.items()
    ]
    return f"<div style='{_BOX}'><table>{''.join(lines)}</table>{problem(session)}</div>"


def problem(session: Session) -> str:
    """Return the error that paused the session, or the message of the last action; empty if there is neither."""
    if session.error:
        first, _, rest = session.error.partition("\n\n")
        return (
            f"<div id='play-error' style='{_RED}'><b>Paused: {html.escape(first)}</b>"
            f"<pre style='font-size:10px;white-space:pre-wrap'>{html.escape(rest[-3000:])}</pre></div>"
        )
    return f"<div id='play-message' style='{_RED}'>{html.escape(session.message)}</div>" if session.message else ""


def contacts(session: Session, feet: Iterable[Foot]) -> str:
    """Return the contacts of the feet, and how far off the policy sees the board."""
    rows = "".join(
        f"<tr><td style='padding-right:12px'>{html.escape(foot.name)}</td><td style='padding-right:12px'>{foot.where}"
        f"</td><td style='text-align:right'>{foot.force:.0f} N</td></tr>"
        for foot in feet
    )
    return f"<div style='{_BOX}'><table>{rows}</table>{html.escape(seen(session))}</div>"


def seen(session: Session) -> str:
    """Return how far the sensed board is from the true one, in words."""
    if not session.env.mdp.sensing.active:
        return "The policy sees the true board."
    found = sensed_board(session, session.selected)
    if found is None:
        return ""
    sim, world = session.env.sim, session.selected
    position, rotation = found
    off = float(((position - sim.board_pos[world].cpu().numpy()) ** 2).sum() ** 0.5)
    turned = rotation.T @ sim.board_rot[world].cpu().numpy()
    angle = math.degrees(math.acos(max(-1.0, min(1.0, (float(turned.trace()) - 1) / 2))))
    return f"The policy sees the board {1000 * off:.0f} mm and {angle:.1f}° off its true pose."


def ends(found: Iterable[End]) -> str:
    """Return the last ends of episodes."""
    rows = "".join(
        f"<tr><td style='padding-right:12px'>world {end.world}</td><td style='padding-right:12px'>{end.seconds:.2f} s"
        f"</td><td style='{'' if end.success else _RED}'>{html.escape(end.words)}</td></tr>"
        for end in found
    )
    return f"<div style='{_BOX}'><table>{rows or '<tr><td>none yet</td></tr>'}</table></div>"

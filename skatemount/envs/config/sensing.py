"""Settings of the robot's sensors and of the delay of its targets."""

from __future__ import annotations

from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, interval, number


@dataclass
class SensingConfig:
    """Errors and delays between the true state and the policy, and between the policy and the motors.

    Sizes are half widths of uniform distributions, for each axis or joint. Ranges ``[low, high]`` are drawn uniformly
    for each episode.

    Attributes:
        target_delay: Time until the motor controllers get a joint target, s; rounded to whole physics steps.
        latency: Age of everything that the policy sees, control steps.
        board_age: Further age of the board's pose, control steps between its measurement and its use.
        board_seen: Probability that a measurement finds the board. Otherwise the last pose that was found is kept.
        board_pos_bias: Error of the board's position in the trunk frame, constant for an episode, m.
        board_rot_bias: Error of the board's rotation about each axis of the trunk, constant for an episode, degrees.
        board_pos_jitter: Further error of each measurement of the position, m.
        board_rot_jitter: Further error of each measurement of the rotation, degrees.
        encoder_offset: Zero error of each joint's encoder, constant for an episode, rad. Observed joint angles and feet
            have it, and so does the angle that the motor controller compares with its target.
        joint_vel_noise: Error of the joint velocities, rad/s.
        gyro_noise: Error of the trunk's angular velocity, rad/s.
        gravity_noise: Error of each axis of gravity's direction, which then gets unit length again.
        term_noise: Whether the observation's terms may add noise of their own (``observation.noise``), which older
            policies were trained with.
    """

    target_delay: list[float] = field(metadata=interval(0, 0.5, "s"))
    latency: list[int] = field(metadata=interval(0, 25, "control steps"))
    board_age: list[int] = field(metadata=interval(0, 25, "control steps"))
    board_seen: float = field(metadata=number(0, 1, above=True))
    board_pos_bias: float = field(metadata=number(0, 1, "m"))
    board_rot_bias: float = field(metadata=number(0, 45, "degrees"))
    board_pos_jitter: float = field(metadata=number(0, 1, "m"))
    board_rot_jitter: float = field(metadata=number(0, 45, "degrees"))
    encoder_offset: float = field(metadata=number(0, 1, "rad"))
    joint_vel_noise: float = field(metadata=number(0, 100, "rad/s"))
    gyro_noise: float = field(metadata=number(0, 100, "rad/s"))
    gravity_noise: float = field(metadata=number(0, 1))
    term_noise: bool

    @property
    def senses_truth(self) -> bool:
        """True if the policy sees the true state at once; the targets may be late all the same."""
        of_board = self.board_pos_bias, self.board_rot_bias, self.board_pos_jitter, self.board_rot_jitter
        of_robot = self.encoder_offset, self.joint_vel_noise, self.gyro_noise, self.gravity_noise
        return not any(of_board + of_robot) and self.latency[1] == self.board_age[1] == 0 and self.board_seen == 1

    def delay_steps(self, timestep: float) -> tuple[int, int]:
        """Return the smallest and the largest delay of the targets, in physics steps of ``timestep`` s."""
        low, high = (round(delay / timestep) for delay in self.target_delay)
        return low, high

    def validate(self, where: str = "sensing") -> None:
        """Raise `ConfigError` for a value that cannot be used; ``where`` names the group in the message."""
        check_bounds(self, where)

"""Scope of the golden data. Everything is written as the user of commit 5ce7322 would have typed it."""

from __future__ import annotations

OLD = "5ce7322"
"""The commit whose code made the stored data."""

TRAININGS = [
    "+stage=gait",
    "+stage=balance",
    "+stage=mount",
    "+stage=approach",
    "+stage=unfixed",
    "+stage=anywhere",
    "+stage=forward",
    "+stage=balance network=medium seed=1",
    "+stage=forward network=medium",
    "+stage=mount seed=3 total_frames=8000000",
    "+stage=gait total_frames=7913472",
    "+stage=approach total_frames=3000000",
    "+stage=unfixed +curriculum=auto",
    "+stage=unfixed +curriculum=auto total_frames=45000000",
    "+stage=unfixed +curriculum=auto observation=history collector.steps=16 algorithm.std_frames=10000000 "
    "algorithm.final_kl=0.003 algorithm.compile=true total_frames=30000000",
    "+stage=unfixed +curriculum=auto total_frames=2500000 collector.enough=2.5 network.symmetric=false",
    "+stage=mount +curriculum=auto curriculum.free_after=null curriculum.distances=[0.06,0.12,0.18,0.24,0.32,0.44] "
    "algorithm.std_frames=6000000 total_frames=10000000",
    "+stage=anywhere algorithm.compile=true",
    "+stage=balance +experiment=paper",
    "+stage=unfixed +experiment=paper",
    "+stage=unfixed +experiment=gpu +curriculum=auto",
    "+stage=unfixed +experiment=gpu +curriculum=auto network=paper collector.steps=24 physics.num_worlds=16384",
    "+curriculum=paper",
    "+curriculum=paper total_frames=4000000 seed=1 network=medium",
    "+stage=balance observation=compact",
    "+stage=mount board=longboard reward.mounted.weight=5",
    "+stage=unfixed board=mini randomization=none robot=a1_isaac",
    "+stage=mount board=paper_text command=zero randomization=paper",
    "+stage=balance physics=warp",
]
"""Command lines of `skatemount.train` in README, docs and docstrings, and a few that use the remaining groups."""

MODELS = {
    "a1_default": "+stage=balance",
    "a1_mini": "+stage=balance board=mini",
    "a1_longboard": "+stage=balance board=longboard",
    "a1_paper_text": "+stage=balance board=paper_text",
    "isaac_isaac": "+stage=balance +experiment=paper",
}
"""Compiled models, by the settings that make them."""

SUITES = [
    "gait",
    "balance-fixed",
    "mount-fixed",
    "mount-unfixed",
    "approach-fixed",
    "approach-unfixed",
    "rolling",
    "far",
    "pushed",
    "low-friction",
    "other-boards",
]
EPISODES = 64

_FAST = (
    " physics.num_worlds=64 collector.steps=8 physics.threads=1 torch_threads=1 logger.evaluate_every=1000"
    " logger.evaluate_episodes=1 logger.final_episodes=0 logger.tensorboard=false"
)
_SMALL = " network.actor=[64,32] network.critic=[64,32] init_from=null"
FRAMES = 5 * 64 * 8
"""Environment steps of five iterations."""

WEIGHTS = {
    "balance": f"+stage=balance total_frames={FRAMES}{_SMALL}{_FAST}",
    "auto": f"+stage=unfixed +curriculum=auto total_frames={FRAMES}{_SMALL}{_FAST}",
    "anywhere": f"+stage=anywhere total_frames={FRAMES}{_FAST}",
    "paper": f"+curriculum=paper total_frames={5 * FRAMES}{_SMALL}{_FAST}",
}
"""Trainings whose weights after five iterations are kept (the chain: five iterations a stage on average)."""

# Without balance, which was trained again after that commit.
POLICIES = ["approach", "best", "gait", "history", "mount", "unfixed"]

STEPS = {
    "unfixed": "+stage=unfixed observation.noise=false",
    "mount": "+stage=mount observation.noise=false randomization=none",
    "gait": "+stage=gait observation.noise=false",
    "paper": "+stage=balance +experiment=paper observation.noise=false",
    "history": "+stage=anywhere observation.noise=false",
}
"""Tasks in which one control step is taken from stored start states."""

UPDATES = {
    "symmetric": "+stage=balance network.actor=[32,16] network.critic=[32,16] algorithm.final_std=0.2",
    "plain": "+stage=balance network.actor=[32,16] network.critic=[32,16] network.symmetric=false "
    "algorithm.clip_value=true algorithm.target_kl=null",
}
"""Trainings of which one PPO update is made from a stored batch."""

SPEED = "+stage=unfixed total_frames={frames} logger.evaluate_every=0 logger.final_episodes=0 logger.tensorboard=false"

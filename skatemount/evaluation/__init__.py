"""MountBench: how well a policy mounts, with intervals, from fixed seeds."""

"""MountBench: success rates of a policy with confidence intervals, from fixed seeds."""

"""Settings of the task, without torch or MuJoCo."""

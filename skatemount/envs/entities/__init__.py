"""Robot, board and arena as dm_control composer entities."""

"""What stands between the scene's force and the hand: one guard a file."""

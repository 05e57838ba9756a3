"""The types of module in a scene: their numbers, and their actions in a tick."""

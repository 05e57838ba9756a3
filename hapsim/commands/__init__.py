"""The commands: they parse, call, and show. What they show is worked out elsewhere, and imported when needed."""

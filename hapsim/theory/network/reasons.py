"""Why something is not worked out."""


class NotWorkedOutError(Exception):
    """The poles of this scene are not worked out for its scheme; the words say why, and follow a colon."""

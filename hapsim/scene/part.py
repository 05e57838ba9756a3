"""What every part of a scene has in common: it cannot be changed, and takes no key that it does not know."""

from pydantic import BaseModel, ConfigDict


class Part(BaseModel):
    """A part of the scene file: frozen, strict about types, and closed to unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

"""`hapsim service`."""

from __future__ import annotations

from typing import Annotated

import typer

from hapsim.commands.arguments import Json, Port, SceneFile, complain, load
from hapsim.errors import UsageError


def service(
    scene: SceneFile,
    port: Port = None,
    user: Annotated[bool, typer.Option("--user", help="For your own service manager, which grants less.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Follow the scene's file, as `run --watch` does.")] = False,
    json: Json = False,
) -> None:
    """Print a systemd unit that runs SCENE, waits for its device, and tells the service manager how it goes."""
    from hapsim.daemon.unit import unit_for, unit_name

    on = load(scene, port).device.port
    if on is None:
        raise UsageError(f"{scene}: a service drives a device: found no port, expected --port, or one in the scene")
    text, name = unit_for(scene, on, of_user=user, watch=watch), unit_name(on)
    if json:
        from hapsim.console.as_json import document

        print(document({"name": name, "unit": text}))
        return
    print(text, end="")
    folder, control = ("~/.config/systemd/user", "systemctl --user") if user else ("/etc/systemd/system", "systemctl")
    complain(f"Save it as {folder}/{name}, then `{control} daemon-reload` and `{control} enable --now {name}`.")

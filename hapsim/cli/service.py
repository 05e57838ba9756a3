"""`hapsim service`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.arguments import Json, Port, SceneFile, complain, load
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.scene import Scene


def service(
    scene: SceneFile,
    port: Port = None,
    user: Annotated[bool, typer.Option("--user", help="For your own service manager, which grants less.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Follow the scene's file, as `run --watch` does.")] = False,
    json: Json = False,
) -> None:
    """Print a systemd unit that runs SCENE, waits for its device, and tells the service manager how it goes."""
    from hapsim.running.unit import closed_to_service, unit_for, unit_name

    loaded = load(scene, port)
    on = loaded.device.port
    if on is None:
        raise UsageError(f"{scene}: a service drives a device: found no port, expected --port, or one in the scene")
    text, name = unit_for(scene, on, of_user=user, watch=watch), unit_name(on)
    _warn_of_refusal(scene, loaded)
    closed = "" if user else closed_to_service(scene)
    if closed:
        complain(closed, "service", "warning")
    if json:
        from hapsim.cli.as_json import document

        print(document({"name": name, "unit": text}))
        return
    print(text, end="")
    folder, control = ("~/.config/systemd/user", "systemctl --user") if user else ("/etc/systemd/system", "systemctl")
    complain(f"Save it as {folder}/{name}, then `{control} daemon-reload` and `{control} enable --now {name}`.")


def _warn_of_refusal(path: str, scene: Scene) -> None:
    """Where `hapsim run` would refuse the scene of this file, for it is surely predicted unstable."""
    from hapsim.prediction import predict
    from hapsim.running.stability import why_not_armed

    why = why_not_armed(path, scene, predict(scene, with_margins=False))
    if why:
        complain(
            f"`hapsim run` will refuse this scene, and the service ends with status 2. {why}", "service", "warning"
        )

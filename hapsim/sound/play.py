"""Playing a scene's sound: sound cards by PortAudio, and the stream to one of them."""

from __future__ import annotations

import atexit
import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from hapsim.errors import UsageError
from hapsim.loop.histogram import histogram_of
from hapsim.loop.sound import SoundRing
from hapsim.loop.system import require_linux
from hapsim.number_format import frequency, short_duration
from hapsim.scene.issue import did_you_mean
from hapsim.sound.resample import Player, play
from hapsim.sound.wav import WavFile

MOST_RATIO = 32.0
_INSTALL = "`pip install 'hapsim[sound]'`, and PortAudio's library (Debian: `apt install libportaudio2`)"
_SHARE = 0.5  # of the latency that is asked for: the card's
_LOST_S = 1.0  # without a block: the card is gone
_REFUSALS = (-9998, -9997, -9996, -9994, -9985)  # of channels, rate, device, format; the device is busy
_FADED_S, _CLOSED_S, _POLL_S = 0.05, 1.0, 0.005


_left_behind: list[Playback] = []
"""Streams that did not close: PortAudio may still call them."""


class OutputDevice(NamedTuple):
    """A sound card or another output of PortAudio."""

    number: int
    name: str
    system: str
    """The sound system that it belongs to: ALSA, JACK Audio Connection Kit."""
    outputs: int
    rate_hz: float
    """Default rate, Hz."""
    latency_s: float
    """Least latency that it declares, s."""
    is_default: bool


def output_devices() -> list[OutputDevice]:
    """Returns the present outputs of PortAudio. Raises UsageError if sounddevice or PortAudio is missing."""
    portaudio = _portaudio()
    chosen = portaudio.default.device[1]
    keys = ("max_output_channels", "default_samplerate", "default_low_output_latency")
    found = enumerate(portaudio.query_devices())
    systems = [one["name"] for one in portaudio.query_hostapis()]
    return [
        OutputDevice._make([number, one["name"], systems[one["hostapi"]], *map(one.get, keys), number == chosen])
        for number, one in found
        if one["max_output_channels"] > 0
    ]


def choose_device(name: str) -> OutputDevice:
    """Returns the output device of this name, part of a name or number; of "" the system's own choice. UsageError where
    there is none, or several have it."""
    devices = output_devices()
    if not devices:
        raise UsageError(
            "no sound card: PortAudio finds nothing to play on. Connect one, or start the sound server that owns it; "
            "--sound-file writes a file without one"
        )
    if not name:
        return next((one for one in devices if one.is_default), devices[0])
    exact = [one for one in devices if name in (one.name, str(one.number))]
    found = exact or [one for one in devices if name.casefold() in one.name.casefold()]
    if len(found) == 1:
        return found[0]
    if found:
        names = ", ".join(f"{one.number} ({one.name}, {one.system})" for one in found)
        raise UsageError(f"--sound-device: '{name}' fits several: {names}; expected one of these numbers")
    hint = did_you_mean(name, [one.name for one in devices])
    raise UsageError(f"--sound-device: found no '{name}'{hint}; `hapsim sound` lists the devices")


def _portaudio() -> Any:
    """Returns the package sounddevice, which loads PortAudio. Raises UsageError if one of them is missing."""
    try:
        import sounddevice
    except ImportError as error:
        raise UsageError(f"sound is played with the package sounddevice, which is not installed: {_INSTALL}") from error
    except OSError as error:
        raise UsageError(f"sounddevice finds no PortAudio ({error}). To play, install {_INSTALL}") from error
    if not sounddevice._initialized:
        sounddevice._initialize()  # anew: cards come and go
    return sounddevice


def _abandon(portaudio: Any) -> None:
    """Keeps sounddevice from ending PortAudio with the program: without its card, or the server of it, PortAudio would
    wait for ever, or abort the program."""
    atexit.unregister(portaudio._exit_handler)


class Playback:
    """A stream to a sound card, which plays what the loop writes into a ring."""

    def __init__(
        self,
        ring: SoundRing,
        step_rate_hz: float,
        *,
        burst: int,
        device: str,
        latency_s: float,
        volume_db: float,
        on_warning: Callable[[str], None],
    ) -> None:
        """Opens the device and is silent. `burst`: frames that the ring gets at once. UsageError where that fails."""
        require_linux("sound", "leave out --sound; --sound-file writes a file")
        portaudio, card = _portaudio(), choose_device(device)
        if step_rate_hz > MOST_RATIO * card.rate_hz:
            raise UsageError(
                f"sound: the scene makes {frequency(step_rate_hz)} of frames, more than {MOST_RATIO:g} times the "
                f"{frequency(card.rate_hz)} of {card.name}: expected fewer substeps, or no --sound"
            )
        self._portaudio = portaudio
        self.name, self._on_warning, self._is_lost = card.name, on_warning, False
        channels = int(ring.record.channels)
        outputs = min(card.outputs, max(channels, 2))
        if channels > outputs:
            on_warning(f"{card.name} has {outputs} of the scene's {channels} channels: the others are not heard")
        rates, volume = (step_rate_hz, card.rate_hz), 10.0 ** (volume_db / 20.0)
        self._player = Player(ring, rates, burst=burst, outputs=outputs, latency_s=latency_s, volume=volume)
        self.record = self._player.record
        """PLAYER of hapsim.sound.resample."""
        stream = {"samplerate": card.rate_hz, "channels": outputs, "device": card.number, "dtype": "float32"}
        try:
            self._stream = portaudio._StreamBase(
                "output",
                callback=portaudio._ffi.cast("PaStreamCallback*", play.address()),
                userdata=portaudio._ffi.cast("void*", int(self.record.address)),
                wrap_callback=None,
                latency=_SHARE * latency_s,
                **stream,
            )
        except portaudio.PortAudioError as error:
            if error.args[-1] not in _REFUSALS:
                _abandon(portaudio)
            where = f"{frequency(card.rate_hz)} and {outputs} channels"
            raise UsageError(f"sound: {card.name} cannot be opened with {where}: {error}") from error
        self.record.output_s = self._stream.latency
        self._seen, self._seen_at = -1, time.monotonic()

    def start(self) -> None:
        """Starts to play the loop's sound. Raises UsageError if the card refuses."""
        try:
            self._stream.start()
        except self._portaudio.PortAudioError as error:
            raise UsageError(f"sound: {self.name} does not start: {error}") from error

    def look(self) -> None:
        """Warns, once, if the card takes no frames any more. The scene goes on without it."""
        blocks, now = int(self.record.blocks), time.monotonic()
        if blocks != self._seen:
            self._seen, self._seen_at = blocks, now
        elif not self._is_lost and now - self._seen_at > _LOST_S:
            self._is_lost = True
            self._on_warning(
                f"{self.name}: the sound card has taken nothing for {short_duration(_LOST_S)}, and is silent from here "
                "on. The scene goes on"
            )

    def fade(self) -> None:
        """Starts a fade-out; returns at once."""
        self.record.quiet = 1

    def close(self) -> None:
        """Fades out and closes the device, or leaves it behind."""
        self.fade()
        give_up = time.monotonic() + _FADED_S
        while self.record.fade > 0.0 and self.record.playing and not self._is_lost and time.monotonic() < give_up:
            time.sleep(_POLL_S)
        closing = threading.Thread(target=self._close_stream, name="sound card", daemon=True)
        closing.start()  # PortAudio waits for ever for some cards that are gone
        closing.join(_CLOSED_S)
        if closing.is_alive() or self._is_lost:
            _left_behind.append(self)
            _abandon(self._portaudio)

    def _close_stream(self) -> None:
        with contextlib.suppress(Exception):  # of a card that is gone
            self._stream.abort()
            self._stream.close()
            if not self._is_lost and self._portaudio._initialized == 1:
                self._portaudio._terminate()


class SoundOutput:
    """The readers of a ring. `file`, `playback`: set where there is one."""

    def __init__(self, ring: SoundRing, in_file: Sequence[int] | None = None) -> None:
        """Makes the readers. `in_file`: pick-ups of the file [default: all]."""
        self._ring, self._lock = ring, threading.Lock()
        self._in_file = slice(None) if in_file is None else list(in_file)
        self.file: WavFile | None = None
        self.playback: Playback | None = None
        self._is_over = False

    def collect(self) -> None:
        """Empties the ring into the file, and looks after the card; from any thread."""
        with self._lock:
            if self.file is not None and (frames := self._ring.drain()).size:
                self.file.put(frames[:, self._in_file], patient=bool(self._ring.record.waits))
        if self.playback is not None:
            self.playback.look()

    def fade(self) -> None:
        """Has the sound fade out: no more frames come."""
        if self.playback is not None:
            self.playback.fade()

    def close(self) -> None:
        """Closes card and file, which then has every frame."""
        if self.playback is not None:
            self.playback.close()
        if self.file is not None:
            self.collect()
            self.file.finish()
        self._is_over = True

    def counts(self) -> dict[str, Any]:
        """Returns the counts of the sound for Progress and Report, by the names of their fields."""
        ring, lost = self._ring.record, 0
        if self.file is not None:
            lost = self._ring.lost + (self.file.unwritten if self._is_over else 0)
        counts = {"sound_frames": int(ring.written), "clipped_sound_values": int(ring.clipped)}
        if self.playback is None:
            return counts | {"lost_sound_frames": lost}
        player = self.playback.record
        latency = histogram_of(player.latency, 1e-9)
        return counts | {
            "lost_sound_frames": lost + int(player.lost),
            "underruns": int(player.underruns + player.card_underruns),
            "resampling_ppm": 1e6 * float(player.slope / player.nominal - 1.0) if latency.total else None,
            "sound_latency_s": (latency.quantile(0.5), latency.quantile(0.99)) if latency.total else None,
        }

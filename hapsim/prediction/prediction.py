"""Stiffness and damping that a hand will feel, and the stability of its scene: each part computed on demand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hapsim.errors import UsageError
from hapsim.laws import Linear
from hapsim.one_thread import one_thread
from hapsim.prediction.characteristic import (
    Piece,
    characteristic_of,
    linear_at,
    piece_at,
    scene_at,
    simulated_places,
)
from hapsim.prediction.correction import Rendering, rendered
from hapsim.prediction.felt_alone import Desired, Felt, Tolerances, desired_of, felt_of
from hapsim.prediction.felt_mass import FeltMass
from hapsim.prediction.line_motion import LinePart, line_parts
from hapsim.prediction.linear import (
    coupling_reason,
    hand_of,
    joined_reason,
    links_of,
    needs_network,
    network_of,
    other_hands,
    spread,
    with_device,
)
from hapsim.prediction.part import Part
from hapsim.prediction.stability import Judge, LinkMargin, Region, link_margins
from hapsim.prediction.state_space import StateSpace, state_space_of
from hapsim.prediction.states import ContactStates
from hapsim.prediction.swings import Shaking
from hapsim.prediction.timing import wire_delay, wire_of, wire_time_of
from hapsim.scene import Scene
from hapsim.scene.input_states import input_states, off_words, used_inputs
from hapsim.scene.values import per_channel
from hapsim.theory import Margins, Mode, Network, margins_of
from hapsim.theory.arrays import sort_by_modulus
from hapsim.theory.network import SURELY, ContinuousMode, continuous_modes, is_large, parts_of, state_size
from hapsim.theory.network.network import is_centred

if TYPE_CHECKING:
    from hapsim.prediction.plane_geometry import PlaneLink
    from hapsim.prediction.plane_states import Slide

Place = float | tuple[float, float] | None
"""Position of a hand, m: in the plane x and y; None: not given."""
Places = Place | Mapping[str, tuple[float, float]]
"""The same, or the places of hands of the plane by their names."""


SNAPS, SLIDES, AT_LIMIT, SWINGS = "in a snap", "slides", "at the limit", "swings on"
"""Verdicts: the scene drives a point on, in a snap or without a stiffness; or nothing decays and nothing grows."""


class Prediction:
    """Prediction of a scene; each part is computed on demand, and once.

    Attributes:
        hands: names of the hands of a scene in the plane; () on a line, as `places` and `links` are empty.
        places: of its hands and masses where it is linearised, m, by module.
        links: every link of it, with its ends at these places.
    """

    points: tuple[str, ...]
    """Names to which a mode's participation refers."""
    _also: Sequence[Sequence[int]] = ()
    """Pairs of points that count as joined."""

    def __init__(self, scene: Scene, at: Places = None, *, with_margins: bool = True, wherever: bool = False) -> None:
        """`at`, `with_margins`: as in `predict`. `wherever`: the scene runs, and its hands may be anywhere."""
        self.scene, self._at, self._with_margins, self._wherever = scene, cast(Any, at), with_margins, wherever
        self._rendering = rendered(scene)
        self.tolerances_found: dict[object, Tolerances] = {}  # of each closed form: hands are alike
        self._seen = self._rendering.seen
        self.hands: Sequence[str] = ()
        self.places: Mapping[str, tuple[float, float]] = {}
        self.links: Sequence[PlaneLink] = ()
        self._take()
        if instead := self.states.instead(self._at is None):
            self._take(instead)
        whys = {name: self._coupling_reason(name) for name in scene.device_points}
        self.coupled: dict[str, str] = {name: why for name, why in whys.items() if why}
        """Device points that are no temporary hybrid systems of their own, each with a reason that follows its name."""
        self.is_lone: bool = not self.coupled and not self._linear.masses
        """True if the scene has nothing but hands, each an oscillator of its own."""
        self.rate = scene.rate
        """Sample rate, Hz."""
        self.wire_time, self.wire_of = wire_time_of(scene), wire_of(scene)
        """Duration of an exchange, and the kind of wire."""
        self.wire_delay = wire_delay(scene)
        """Sentence on the declared and the wire's delay, which this prediction assumes; "" if the wire adds none."""

    def _take(self, instead: Mapping[str, Linear] | None = None) -> None:
        """Sets the linear form of the scene; `instead` replaces the forms of some links."""
        self._linear = scene_at(self._seen, self._at, instead)
        seen, self.points = network_of(self._seen, self._linear)
        self.network = self._on_clocks(self._rendering.on_device(seen))
        if seen.board is not None and is_large(seen):
            found = f"found board in a scene with {state_size(seen)} numbers in its state"
            raise UsageError(f"device.law: {found}, expected host: it is too large to predict")
        self.states = ContactStates(self._seen, self._linear, self.network, self.points)
        """States of its contacts."""

    def _on_clocks(self, network: Network) -> Network:
        """Returns the network with the clocks of several devices, if its hands have them."""
        return network

    def _coupling_reason(self, name: str) -> str:
        return coupling_reason(self._seen, self._linear, name)

    @cached_property
    def _lone(self) -> tuple[Felt, ...]:
        names = (name for name in self.scene.device_points if name not in self.coupled)
        return tuple(felt_of(self._rendering, self._linear, name) for name in names)

    def driven(self, name: str, *, as_written: bool = False) -> Felt | None:
        """Closed form of a hand on grounds behind a transmission or a motor that lags; None for another. `as_written`:
        on the scene's links, not on those that a correction renders."""
        scene, linear = self._seen, self._linear
        if as_written:
            scene = self._rendering.desired
            linear = scene_at(scene, self._at)
        is_driven = name in self.coupled and not scene.device.is_admittance
        if not is_driven or joined_reason(scene, linear, name):
            return None
        return Felt(name, scene.device_points[name].channel, *hand_of(scene, linear, name))

    @cached_property
    def felt(self) -> tuple[Felt, ...]:
        """Predictions for the device points that are temporary hybrid systems of their own, in the scene's order."""
        return self._lone

    def regions_of(self, name: str, around: float | None = None) -> tuple[Region, ...]:
        """Returns the regions of the hand at this device point, by position; at one place first the one with all
        friction stuck and curves between their branches. Empty if it moves more than itself. `around`: as in
        `characteristic_of` [default: its assumed position]."""
        around = (self._at or 0.0) if around is None else around
        hand = characteristic_of(self._rendering.desired, name, around, self._wherever)
        same = self._seen is self._rendering.desired and around == 0.0
        simulated = hand if same else characteristic_of(self._seen, name, wherever=self._wherever)
        if hand is None or simulated is None:
            return ()
        hands, found = [(hand, simulated), *zip(hand.variants(), simulated.variants(), strict=True)], []
        way = hand.crossing * self.scene.period
        for own, at in hands:
            for piece in own.pieces():
                here, width = linear_at(at, self._linear, piece), piece.high - piece.low
                is_crossed = piece.stiffness + own.own_stiffness < 0.0 and width < way
                links = links_of(here, name)
                if is_crossed:  # no hand rests there, and one that crosses meets the fall spread over its way
                    links = {link: spread(one, width / way) for link, one in links.items()}
                    here = here._replace(links=here.links | links)
                found.append(Region(piece, felt_of(self._rendering, here, name), links, own, is_crossed))
        return tuple(sorted(found, key=lambda one: one.piece.low) if len(hands) > 1 else found)

    @cached_property
    def _every_region(self) -> dict[str, tuple[Region, ...]]:
        """Regions of each hand that is an oscillator of its own with piecewise links."""
        every = {name: self.regions_of(name) for name in self.scene.device_points if name not in self.coupled}
        return {name: found for name, found in every.items() if found and found[0].hand.is_regional}

    @cached_property
    def regions(self) -> dict[str, tuple[Region, ...]]:
        """Regions of each hand that feels other springs and dampers at other places; `felt` is that of one region."""
        return {name: found for name, found in self._every_region.items() if len(found) > 1}

    @cached_property
    def here(self) -> dict[str, Piece]:
        """Assumed piece of each of these hands."""
        at, found = self._at, {}
        for name, (first, *_) in self.regions.items():
            hand = first.hand
            found[name] = piece_at(hand, name, at if at is not None and hand.low <= at <= hand.high else None)
        return found

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Parts of the scene that no link joins and that have hands, in the scene's order."""
        # Of hands alone each is a part: to look for links that join them would take a tenth of a swept prediction.
        part = np.arange(len(self.points)) if self.is_lone else parts_of(self.network, also=self._also)
        points, found = self.scene.device_points, dict[int, list[str]]()
        for name in points:
            found.setdefault(int(part[self.points.index(name)]), []).append(name)
        return tuple(
            Part(tuple(names), tuple(points[name].channel for name in names), self, np.flatnonzero(part == its))
            for its, names in found.items()
        )

    def __repr__(self) -> str:
        rows, units = [one for part in self.parts for one in part.rows if not one.of], self.scene.units
        feel = "; ".join(
            f"{one.hand} feels {units(one.k, 'N/m', '.6g')}, {units(one.b, 'N·s/m', '.6g')}" for one in rows
        )
        about = f"{self.scene.path or 'a scene'} at {self.rate:g} Hz"
        return f"<Prediction of {about}: {self.verdict}; {feel or 'hands: ' + ', '.join(self.scene.device_points)}>"

    def state_space(self) -> StateSpace:
        """Returns the matrices of the closed loop as it is linearised. Raises UsageError for a large scene."""
        return state_space_of(self.network)

    def part_on(self, channel: int) -> Part | None:
        """Returns the part of the scene with this channel; None if none has it."""
        return next((one for one in self.parts if channel in one.channels), None)

    @property
    def written(self) -> Network:
        """Network of the desired scene, without the correction."""
        return network_of(self._rendering.desired, scene_at(self._rendering.desired))[0]

    @cached_property
    def judge(self) -> Judge:
        """Verdict on the stability of the scene."""
        regions = self.regions.items() if self._at is not None else ()
        held = {name for name, every in regions if any(one.kind == "held" and one.is_stable for one in every)}
        loose = tuple(felt for felt in self._lone if not felt.settles and felt.name not in held)
        judged = {name: one for name, one in self._every_region.items() if not needs_network(self._seen, name)}
        return Judge(self.network, self.points, self.is_lone, judged, loose, self.states)

    @cached_property
    def with_inputs_off(self) -> dict[str, Prediction]:
        """Predictions of the scene in the other states of the inputs that its gates need, by words such as "touch is
        off"; margins aside. This prediction itself is for all of them on."""
        used, found = used_inputs(self.scene), dict[str, Prediction]()
        for on in input_states(self.scene):
            off = [name for name in used if name not in on]
            seen = self.scene.with_inputs(on)
            found[off_words(off)] = type(self)(seen, self._at, with_margins=False, wherever=self._wherever)
        return found

    @cached_property
    def in_other_hands(self) -> dict[str, Prediction]:
        """Predictions for the other hands that a device in admittance assumes, by words such as "the hand has 300 N/m
        and 5 N·s/m"; this one is for the stiffest with the least damping. Empty where it assumes one hand."""
        return {
            words: type(self)(with_device(self.scene, assumed_hand=hand), self._at, with_margins=False)
            for words, hand in other_hands(self.scene).items()
        }

    @property
    def felt_masses(self) -> tuple[FeltMass, ...]:
        """Mass and damping that each hand feels in admittance, in the stiffest assumed hand; empty in impedance."""
        return tuple(one for part in self.parts for one in part.felt_masses)

    @property
    def _by_inputs(self) -> dict[str, Prediction]:
        """Predictions in all states of the inputs, and of the hand, by words; "": all inputs are on."""
        return {"": self, **self.with_inputs_off, **self.in_other_hands}

    @cached_property
    def _shaken(self) -> tuple[str, Prediction] | None:
        """First state of the inputs in which something surely shakes a hand, in words, and its prediction."""
        return next((one for one in self._by_inputs.items() if one[1].judge.shaking is not None), None)

    @cached_property
    def decisive(self) -> tuple[str, Prediction]:
        """The state of the inputs that decides the verdict, in words ("": all of them are on), and its prediction. One
        in which a free hand drifts decides nothing."""
        if len(every := self._by_inputs) == 1 or self._shaken is not None:
            return self._shaken or ("", self)
        return next((one for one in every.items() if one[1]._verdict not in ("stable", AT_LIMIT)), ("", self))

    @property
    def every(self) -> tuple[Prediction, ...]:
        """Predictions that make up this one: it alone, or those of sections of several devices."""
        return (self,)

    @property
    def shaking(self) -> Shaking | None:
        """Motion that will surely shake a hand, in any state of the inputs; None if there is none."""
        words, one = self._shaken or ("", self)
        found = one.judge.shaking
        if found is None or not words:
            return found
        return found._replace(state=" and ".join(filter(None, (words, found.state))))

    def work_out(self) -> None:
        """Works out what takes long, the verdict and the margins: later answers take no time."""
        _ = self.margins, self.stable

    def is_soon_stable(self, most_states: int) -> bool:
        """Returns whether `Judge.is_soon_stable` is true in every state of the inputs."""
        return all(one.judge.is_soon_stable(most_states) for one in self._by_inputs.values())

    @property
    def by_its_scheme(self) -> bool:
        """True if poles, modes and margins are those of the scene's own scheme, False if of CORDIS's."""
        return not self.judge.solved.instead

    @property
    def stable(self) -> bool:
        """True if the scene is stable, for the computed poles (see `poles_method`), in every state of its inputs."""
        return self.judge.is_stable and self.decisive[1] is self

    @property
    def verdict(self) -> str:
        """Verdict on the scene in a word or three, over every state of its contacts and inputs."""
        return self.decisive[1]._verdict

    @property
    def _verdict(self) -> str:
        """Verdict with every input on."""
        if (here := self.verdict_here) in (SNAPS, SLIDES):
            return here
        if self.trembles:
            return "trembles"
        if not self.is_judged:
            return "not judged"
        if self.judge.swings_on:
            return SWINGS
        return AT_LIMIT if self.at_limit else "stable" if self.judge.is_stable else "unstable"

    @property
    def in_snap(self) -> tuple[str, ...]:
        """Hands whose assumed region is a snap."""
        here = ((part.names[0], part.region_here) for part in self.parts)
        return tuple(name for name, region in here if region is not None and region.kind == "snap")

    @property
    def verdict_here(self) -> str:
        """Verdict on the scene as it is linearised."""
        if self.in_snap:
            return SNAPS
        if self.stable_as_taken:
            return "stable"
        return AT_LIMIT if abs(self.spectral_radius_here - 1.0) < SURELY - 1.0 else "unstable"

    @property
    def stable_as_taken(self) -> bool:
        """True if it is stable with contacts that move masses as in `assumptions`: margins and modes are of that."""
        return self.judge.is_stable_as_taken

    def contacts_at(self, hands: Mapping[str, float]) -> str:
        """Returns a phrase for the contacts that move masses, such as "finger is touched", while all hands hold still
        at these positions (m) and the masses rest; "" if there are none, or no rest is found. Where `felt` assumes
        another state, the phrase says so."""
        from hapsim.prediction.reach import distances_at_rest

        names = {name for part in self.states.parts for state in part[:1] for name in state}
        if not names:
            return ""
        try:
            at = distances_at_rest(self._seen, hands)
        except UsageError:
            return ""
        laws = {name: link.law() for name, link in self._seen.links.items() if name in names}
        found = ", ".join(f"{name} is {state}" for name, law in laws.items() if (state := law.state(at[name])))
        assumed = []
        for name, law in laws.items():
            taken, here = self._linear.links[name], law.linear(at[name])
            pieces = [one.state for one in law.pieces if (one.slope, one.damping) == (taken.stiffness, taken.damping)]
            if (taken.stiffness, taken.damping) != (here.stiffness, here.damping) and pieces:
                assumed.append(f"{name} is {pieces[0]}")
        return f"{found}; k and b are those while {' and '.join(assumed)}" if assumed else found

    @property
    def slides(self) -> tuple[Slide, ...]:
        """Motions that a scene in the plane drives without an oscillation, the fastest first."""
        return ()

    @property
    def is_held(self) -> bool:
        """True if the first hand can be measured where it is: on a line, or where a link of the plane acts on it, no
        shape is in the way from its start, and it does not slide off."""
        return True

    @property
    def is_judged(self) -> bool:
        """True if there is a verdict: either a motion is unstable, or each state that was found was judged."""
        return not self.states.unjudged or not self.stable_as_taken or bool(self.states.growing)

    @property
    def lined(self) -> list[LinePart]:
        """Parts of a scene on a board whose motions from piece to piece are simulated."""
        return [part for part, _ in line_parts(self._seen, self._linear, self.network, self.points)]

    @property
    def trembles(self) -> tuple[str, ...]:
        """Points that oscillate by themselves, by under a count and with hardly a force, if no hand is shaken more."""
        return () if self.judge.shaking or self.network.board else tuple(self.judge.swings)

    @property
    def at_limit(self) -> bool:
        """True if the scene is neither stable nor unstable: a motion drifts or oscillates with a constant amplitude."""
        return not self.judge.is_stable and abs(self.spectral_radius - 1.0) < SURELY - 1.0

    @cached_property
    def spectral_radius(self) -> float:
        """Largest modulus of a pole, over all regions of the hands."""
        grown = [one.growth for regions in self.judge.regions.values() for one in regions]
        return max([self.spectral_radius_here, *grown, *(one.growth for one in self.states.growing)])

    @property
    def spectral_radius_here(self) -> float:
        """Largest modulus of a pole of the scene as it is linearised."""
        if self.is_lone:
            return max(one.spectral_radius for one in self._lone)
        return self.judge.solved.solution.spectral_radius

    @cached_property
    def poles(self) -> tuple[complex, ...]:
        """Poles of the whole closed loop, by decreasing modulus, without those at zero; for a large scene only some."""
        if self.is_lone:
            poles = sort_by_modulus(np.array([pole for one in self._lone for pole in one.poles], complex))
        else:
            poles = self.judge.solved.solution.poles
        return tuple(complex(pole) for pole in poles if abs(pole) > 1e-9)

    @property
    def poles_in_all(self) -> int:
        """Number of poles of the closed loop, those at zero included."""
        return self.judge.solved.solution.all

    @property
    def poles_method(self) -> str:
        """Sentence on which poles of a large scene were computed; "" for all."""
        return self.judge.solved.solution.method

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Modes of the whole closed loop, the slowest to decay first."""
        return tuple(self.judge.solved.solution.modes)

    @cached_property
    def _margins(self) -> Margins:
        if not self._with_margins:
            return Margins([])
        network, solution, _ = self.judge.solved
        if not is_centred(network):  # searched by scipy too: `one_thread` has to find its libraries
            import scipy.linalg  # noqa: F401
        with one_thread(not is_centred(network) and not is_large(network)):
            return margins_of(network, solution.poles)

    @cached_property
    def margins(self) -> tuple[LinkMargin, ...]:
        """Gain margins, one for each link, in the scene's order; empty without `with_margins`."""
        every = [one for regions in self.regions.values() for one in regions]
        return link_margins(self._linear, self._margins, self._lone, every)

    @property
    def margins_method(self) -> str:
        """Sentence on which links of a large scene were computed, and how reliably; "" for all."""
        return self._margins.method

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Sentences on the simplifications of the theory for this scene."""
        instead = [self.judge.solved.instead] if self.judge.solved.instead else []
        units, channels = self.scene.units, self.scene.channels
        if (at := self.scene.device.mass_at) is not None:
            pose = ", ".join(units.number(one, "m", "g") for one in per_channel(at, channels))
            instead.append(
                f"k and b are valid near {units(pose, 'm')} (device.mass_at): elsewhere the device has another mass "
                "and friction, and a force on one channel also moves others"
            )
        if self.scene.device.is_admittance:
            instead += simulated_places(self._seen, self._at)
        return (*self._linear.assumptions, *instead)

    @property
    def rendering(self) -> Rendering | None:
        """Corrected scene that runs, or None without a correction: `stiffness` and `damping` of `felt`, poles, modes
        and margins belong to it."""
        return None if self._rendering.kind is None else self._rendering

    @property
    def changes_values(self) -> bool:
        """True if a correction simulates other values than the scene's."""
        kind = self._rendering.kind
        return kind is not None and not kind.by_sensors

    @cached_property
    def desired(self) -> tuple[Desired, ...]:
        """Desired stiffness and damping, for the same device points as `felt`; empty without a correction."""
        return tuple(desired_of(self._rendering, self._lone, self.here))

    @cached_property
    def desired_modes(self) -> tuple[ContinuousMode, ...]:
        """Modes of the scene in continuous time, the slowest to decay first; empty without a correction."""
        if self._rendering.kind is None or is_large(network := self.written):
            return ()
        return tuple(continuous_modes(network))

    @property
    def k(self) -> float:
        """Felt stiffness of the first hand that is a system of its own, N/m; NaN if there is none."""
        return self.felt[0].k if self.felt else math.nan

    @property
    def b(self) -> float:
        """Felt damping of that hand, N·s/m; NaN if there is none."""
        return self.felt[0].b if self.felt else math.nan

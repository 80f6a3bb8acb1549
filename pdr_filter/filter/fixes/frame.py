"""Which frame a track is in, and what is known of how to bring it into that of its fixes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pdr_filter.filter.fixes.alignment import Alignment, Place
from pdr_filter.filter.fixes.frame_rotation import (
    MAX_ANGLE_STD_RAD,
    MAX_PAIRS,
    Compass,
    OpenTurn,
    PairedPoint,
    agreed_turn,
    agreement_limit,
    align,
    disagreement,
    open_turn,
    thinned,
)
from pdr_filter.filter.imm.motion_model import MAX_HEADING_VARIANCE
from pdr_filter.values import Origin, wrap_angle

# One in twenty right headings conflicts more with the positions: the turn stays open until these decide.
_UNSURE = 3.84


@dataclass(frozen=True, eq=False)
class Frame:
    """Whether the track is in the frame of the fixes, and what is known of how to bring it there."""

    is_joined: bool
    since: int = 0  # steps before the heading was lost and the frame with it, zero for that of the start
    pairs: tuple[PairedPoint, ...] = ()  # fixes until it is; where the heading was lost the place there before them
    agreeing: tuple[PairedPoint, ...] = ()  # those of them that can all be right
    turn: OpenTurn | None = None  # from the first of them on, as they show it
    compass: Compass | None = None  # until it is
    north_var_rad2: float = math.inf  # of the turn before any position fix: infinite if it may be anything
    north_conflict: float = 0.0  # by how much the squared errors of the positions are smaller without that
    north: Alignment | None = None  # how a heading fix had turned the frame of the start before the position fixes
    alignment: Alignment | None = None  # how the frame of the start became that of the fixes
    later: tuple[Alignment, ...] = ()  # how frames after a lost heading became it, and how fixes moved the track

    @property
    def moves(self) -> tuple[Alignment, ...]:
        """How fixes moved the track, each from its step on (`doubt`)."""
        return tuple(turn for turn in self.later if turn.since == turn.n_steps)

    @property
    def turn_var_rad2(self) -> float:
        """Variance of a turn that is not in the filter's states: of a frame that is joined, none."""
        if self.is_joined:
            return 0.0
        turn = self._provisional or self._open
        return turn.angle_var_rad2 if turn else 0.0 if self.compass is None else self.compass.std_rad**2

    @property
    def is_known(self) -> bool:
        """Whether positions are in the frame of fixes, be the turn settled or not."""
        return self.turn is not None or self.alignment is not None

    @property
    def name(self) -> str:
        """Which one positions are in: that of the "fixes", that of the start with true "north", or of the "start"."""
        if self.is_known:
            return "fixes"
        return "start" if self.compass is None else "north"

    @cached_property
    def _open(self) -> OpenTurn | None:
        """What fixes and compass show of the turn; None before the first fix, and once it is settled."""
        return None if self.turn is None else self.turn.with_compass(self.compass)

    @property
    def is_north_wrong(self) -> bool:
        """True while the positions contradict what was known of the turn before them: a heading fix was wrong.

        A wrong heading costs as much as an outlier at the limit of its gate, and so does each position left out.
        """
        return self.north_conflict > agreement_limit(1)

    @property
    def turn_prior_var_rad2(self) -> float:
        """Variance of the turn before any position fix, infinite if the positions contradict it."""
        return math.inf if self.is_north_wrong else self.north_var_rad2

    @cached_property
    def _provisional(self) -> Alignment | None:
        """Alignment by a heading that the positions do not confirm yet; None without such a heading."""
        if self._open is None or math.isinf(self.turn_prior_var_rad2) or not self._open.is_narrow:
            return None
        return align(self.agreeing, 0, self.turn_prior_var_rad2, self.compass)

    def world(self, place: Place) -> Place:
        """Convert a place to the coordinate frame of the fixes, with the current estimate of the rotation.

        The frame of the place follows from its number of steps: the frame of the start, or the frame that began
        where the heading was lost.
        """
        for alignment in (self.north, self.alignment, *self.later):
            if alignment is not None and alignment.turns(place):
                place = alignment.world(place)
        if self.is_joined or place.n_steps < self.since:
            return place
        turn = self._provisional or self._open or self.present_turn
        return place if turn is None else turn.world(place)

    def origin(self, place: Origin) -> Origin:
        """Where the fixes have their zero, with how well they put the track there as they settled its turn, or so far.

        The turn is that of the frame of the start, a heading fix before them included.
        """
        before_rad = 0.0 if self.north is None else self.north.angle_rad
        turn = self.alignment or self._provisional or self._open
        if turn is None:
            return place
        return replace(
            place,
            turn_rad=float(wrap_angle(before_rad + turn.angle_rad)),
            turn_std_rad=math.sqrt(turn.angle_var_rad2),
            position_std_m=math.sqrt(turn.centre_var_m2),
        )

    def drawn(self) -> Frame:
        """The same for a picture of the track, which keeps its shape: an open turn is the most probable one."""
        if self._open is None or self._provisional is not None:
            return self
        return replace(self, turn=self._open.most_probable(), compass=None)

    def with_pair(self, pair: PairedPoint) -> Frame:
        """With one more pair."""
        return replace(self, pairs=thinned((*self.pairs, pair), MAX_PAIRS))._turned()

    def _turned(self) -> Frame:
        """With what the pairs say of the turn."""
        if not self.pairs:
            return self
        # what is known of a place from before is no fix among others: see `doubt` for when it is wrong
        n_sure = 1 if self.since else 0
        agreeing, turn = agreed_turn(self.pairs, self.north_var_rad2, n_sure)
        turned = replace(self, agreeing=agreeing, turn=turn, north_conflict=0.0)
        if self.is_open:
            return turned
        free_agreeing, free_turn = agreed_turn(self.pairs, math.inf, n_sure)  # without the prior of north
        with_prior = disagreement(self.pairs, agreeing, self.north_var_rad2)
        turned = replace(turned, north_conflict=with_prior - disagreement(self.pairs, free_agreeing, math.inf))
        return replace(turned, agreeing=free_agreeing, turn=free_turn) if turned.is_north_wrong else turned

    def with_north(self, north: Alignment) -> Frame:
        """Return the frame after a heading fix has rotated it.

        The remaining rotation has the variances of north and of the heading fix together.
        """
        frame = replace(self, compass=None, north_var_rad2=north.angle_var_rad2)
        frame = replace(frame, later=(*self.later, north)) if self.since else replace(frame, north=north)
        return frame._turned()

    def with_compass(self, compass: Compass) -> Frame:
        """With what the magnetic field says by now; a heading fix knows better."""
        return replace(self, compass=compass) if self.is_open else self

    @property
    def is_settled(self) -> bool:
        """True if the track bends, and its turn is clear: of positions, compass and a heading fix before them."""
        turn = self._open if self._bends else None
        if turn is not None and self.turn_prior_var_rad2 <= MAX_ANGLE_STD_RAD**2:
            if self.north_conflict > _UNSURE:
                return False
            turn = open_turn(self.agreeing).with_compass(self.compass)
        return turn is not None and turn.is_narrow

    @property
    def _bends(self) -> bool:
        """Whether the track is as wrong as its fixes.

        Until then fixes rotate and shift the whole track. Once the rotation is settled, each of them corrects position
        and heading from then on, which bends the track.
        """
        walked_m2 = [pair.walked_var_m2 for pair in self.agreeing]
        return bool(walked_m2) and max(walked_m2) - min(walked_m2) > min(pair.var_m2 for pair in self.agreeing)

    @property
    def is_open(self) -> bool:
        """Whether nothing but positions and the magnetic field has settled the turn."""
        return not self.is_joined and self.north_var_rad2 > MAX_ANGLE_STD_RAD**2

    def joined(self, alignment: Alignment) -> Frame:
        """With the turn settled."""
        frame = Frame(
            is_joined=True,
            north=self.north,
            alignment=self.alignment,
            later=self.later,
            north_conflict=self.north_conflict,
        )
        if self.since == 0:
            return replace(frame, alignment=alignment)
        if self.since == alignment.n_steps:  # no step was reported in it
            return frame
        return replace(frame, later=(*self.later, replace(alignment, since=self.since)))

    def opened(self, pairs: tuple[PairedPoint, ...], turn_var_rad2: float, n_steps: int) -> Frame:
        """With the turn open again from the place of the first pair on, where the heading was lost."""
        var = turn_var_rad2 if turn_var_rad2 < MAX_HEADING_VARIANCE else math.inf
        return replace(self, is_joined=False, since=n_steps, pairs=pairs, north_var_rad2=var)._turned()

    def most_probable(self, n_steps: int) -> Alignment:
        """The alignment of a turn that stays open, for what comes after."""
        if self._open is None:
            raise ValueError("the rotation of this frame is settled: use its alignment")
        return replace(self._provisional, n_steps=n_steps) if self._provisional else self._open.alignment(n_steps)

    @property
    def present_turn(self) -> Alignment | None:
        """The most probable alignment of the present frame; None where it is that of the positions."""
        if self.is_joined:
            return None
        if self._open is not None:
            return self.most_probable(0)
        if self.compass is None:
            return None
        angle_rad, var_rad2 = self.compass.angle_rad, self.compass.std_rad**2
        return Alignment(angle_rad, var_rad2, np.zeros(2), np.zeros(2), 0.0, 0)

    def moved(self, alignment: Alignment) -> Frame:
        """With the places of the track moved."""
        return replace(self, pairs=tuple(pair.moved(alignment.positions) for pair in self.pairs))._turned()


START_FRAME = Frame(is_joined=True)


UNKNOWN_FRAME = Frame(is_joined=False)

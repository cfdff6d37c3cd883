"""Faults with a seed, put into a real or simulated RINEX 3 recording.

The truth of the recording stays the truth of what comes out. The same seed gives the same file.
Faults are applied in the order of `CATALOGUE`, whatever order they are named in.
"""

import random

from .rinex import HALF_CYCLE, LOST_LOCK, SPEED_OF_LIGHT, Value

# Mean extra path of a cold start between houses, and of a reflection beyond its minimum (m).
START_LATE_M = 60.0
REFLECTED_M = 30.0
REFLECTED_LEAST_M = 5.0
# Fraction of satellites whose ranges are late in a cold start between houses.
START_LATE_SHARE = 0.6
# Mean length of a reflection; also that of the pauses if reflections take half of the time (s).
REFLECTION_S = 25.0
# Fraction of reflections at whose ends the receiver loses lock.
REFLECTION_LOSES_LOCK = 0.7
JUMP_S = 20.0
HALF_CYCLE_S = 5.0
CLOCK_STEP_EVERY_S = 97.0
CLOCK_STEP_S = 1e-3
SHORTEST_GAP_S, LONGEST_GAP_S = 3.0, 40.0
REPEATED_EVERY = 50
WEAKEST_LEFT = 3


class UnknownFault(Exception):
    """No fault has this name, or its value is invalid."""


def inject(observations, faults, seed):
    """A copy with `faults` (texts like `thin=5`), and the disturbed spans, [begin, end) (s).

    Only a fault that ends has spans. A fault of the whole recording has none.
    """
    wanted = dict((text.split("=", 1) + [""])[:2] for text in faults)
    unknown = [name for name in wanted if name not in CATALOGUE]
    if unknown:
        raise UnknownFault(f"no fault is named {unknown[0]}; there are {', '.join(CATALOGUE)}")
    changed, spans = observations.copy(), []
    for name, (apply, takes_value) in CATALOGUE.items():
        if name not in wanted:
            continue
        if takes_value != bool(wanted[name]):
            raise UnknownFault(f"fault {name} takes {'a' if takes_value else 'no'} value")
        # Each fault has its own random numbers, so that they do not depend on the other faults.
        stream = random.Random(f"{seed} {name}")
        spans += apply(changed, wanted[name], stream) or []
    return changed, spans


def _pair(text):
    first, second = text.split(":")
    return float(first), float(second)


def _within(observations, begin_s, length_s):
    """The epochs from `begin_s` after the first on, for `length_s`; and their span."""
    start = observations.epochs[0].time + begin_s
    inside = [epoch for epoch in observations.epochs if start <= epoch.time < start + length_s]
    return inside, [(start, start + length_s)]


def _delay(satellite, metres):
    """Makes the pseudoranges longer; phases stay."""
    for code in satellite.of_kind("C"):
        satellite.values[code] = satellite.values[code].plus(metres)


def _flag(satellite, bits):
    for code in satellite.of_kind("L"):
        satellite.values[code] = satellite.values[code].with_lock(bits)


def _by_satellite(observations):
    """Each satellite of each epoch with the time since its last epoch (s), 0 at its first."""
    last = {}
    for epoch in observations.epochs:
        for satellite in epoch.satellites:
            yield epoch, satellite, epoch.time - last.get(satellite.name, epoch.time)
            last[satellite.name] = epoch.time


def cut(observations, value, _stream):
    """`S:L`: keeps only the epochs from S to S + L seconds after the first."""
    observations.epochs, _ = _within(observations, *_pair(value))


def thin(observations, value, _stream):
    """`K`: every K-th epoch. A loss of lock in an epoch left out is flagged at the next one kept."""
    every, lost = int(value), {}
    for index, epoch in enumerate(observations.epochs):
        for satellite in epoch.satellites:
            for code in satellite.of_kind("L"):
                reading = satellite.values[code]
                key = satellite.name, code
                is_lost = reading.lock.strip() and int(reading.lock) & LOST_LOCK
                if index % every:
                    lost[key] = lost.get(key) or is_lost
                elif lost.pop(key, False):
                    satellite.values[code] = reading.with_lock(LOST_LOCK)
    observations.epochs = observations.epochs[::every]


def cn0_shift(observations, value, _stream):
    """`DB`: added to every C/N0."""
    _change_cn0(observations, lambda cn0: cn0 + float(value))


def cn0_scale(observations, value, _stream):
    """`F`: C/N0 about 40 dB-Hz, times F."""
    _change_cn0(observations, lambda cn0: 40.0 + (cn0 - 40.0) * float(value))


def _change_cn0(observations, change):
    for _, satellite, _ in _by_satellite(observations):
        _change_strength(satellite, change)


def _change_strength(satellite, change):
    for code in satellite.of_kind("S"):
        old = satellite.values[code]
        satellite.values[code] = Value(change(old.number), old.lock, old.strength)


def bad_start(observations, value, stream):
    """`S`: for the first S seconds 60 % of the satellites are late by a constant each."""
    late = {}
    for name in observations.satellites():
        is_late = stream.random() < START_LATE_SHARE
        late[name] = stream.expovariate(1.0 / START_LATE_M) if is_late else 0.0
    inside, spans = _within(observations, 0.0, float(value))
    for epoch in inside:
        for satellite in epoch.satellites:
            _delay(satellite, late[satellite.name])
    return spans


def blackout(observations, value, _stream):
    """`S:L`: after S seconds, for L seconds, the weakest three satellites only."""
    inside, spans = _within(observations, *_pair(value))
    for epoch in inside:
        weakest = sorted(epoch.satellites, key=lambda one: (one.best_cn0(), one.name))
        kept = {one.name for one in weakest[:WEAKEST_LEFT]}
        epoch.satellites = [one for one in epoch.satellites if one.name in kept]
    return spans


def reflect(observations, value, stream):
    """`P`: each satellite is reflected for a fraction P of the time, about 25 s each time."""
    share, reflections = float(value), {}
    begin_rate = share / max(1e-3, 1.0 - share) / REFLECTION_S
    for _, satellite, elapsed_s in _by_satellite(observations):
        reflection = reflections.get(satellite.name)
        rate = begin_rate if reflection is None else 1.0 / REFLECTION_S
        if stream.random() < rate * elapsed_s:
            reflection = _Reflection(stream) if reflection is None else reflection.end(satellite)
            reflections[satellite.name] = reflection
            if reflection is not None:
                reflection.begin(satellite)
        if reflection is not None:
            reflection.disturb(satellite, elapsed_s, stream)


class _Reflection:
    """One satellite seen by a wall: late, slowly changing, weaker."""

    def __init__(self, stream):
        self.late_m = REFLECTED_LEAST_M + stream.expovariate(1.0 / REFLECTED_M)
        self.rate_m_s = stream.gauss(0.0, 0.3)
        self.loss_db = stream.uniform(0.0, 6.0)
        self.loses_lock = stream.random() < REFLECTION_LOSES_LOCK

    def begin(self, satellite):
        if self.loses_lock:
            _flag(satellite, LOST_LOCK)

    def end(self, satellite):
        self.begin(satellite)

    def disturb(self, satellite, elapsed_s, stream):
        self.late_m = max(1.0, self.late_m + self.rate_m_s * elapsed_s)
        _delay(satellite, self.late_m + stream.gauss(0.0, 1.0))
        _change_strength(satellite, lambda cn0: max(10.0, cn0 - self.loss_db))


def jump(observations, value, stream):
    """`S:M`: after S seconds half of the satellites are M metres late for 20 s."""
    begin_s, metres = _pair(value)
    names = observations.satellites()
    chosen = set(stream.sample(names, len(names) // 2))
    inside, spans = _within(observations, begin_s, JUMP_S)
    for epoch in inside:
        for satellite in epoch.satellites:
            if satellite.name in chosen:
                _delay(satellite, metres)
    return spans


def wild(observations, value, stream):
    """`P`: a fraction P of pseudoranges is wrong by milliseconds of light, or by 1 to 10 000 km."""
    share = float(value)
    for _, satellite, _ in _by_satellite(observations):
        for code in satellite.of_kind("C"):
            if stream.random() < share:
                milliseconds = stream.choice([-2, -1, 1, 2, 20])
                far_m = 10.0 ** stream.uniform(3.0, 7.0)
                off_m = stream.choice([SPEED_OF_LIGHT * 1e-3 * milliseconds, far_m])
                satellite.values[code] = satellite.values[code].plus(off_m)


def slips(observations, value, stream):
    """`R`: R slips of 1 to 50 cycles per signal and hour, half of them reported."""
    per_second, slipped = float(value) / 3600.0, {}
    for _, satellite, elapsed_s in _by_satellite(observations):
        for code in satellite.of_kind("L"):
            key = satellite.name, code
            if stream.random() < per_second * elapsed_s:
                cycles = stream.choice([-1, 1]) * stream.randint(1, 50)
                slipped[key] = slipped.get(key, 0) + cycles
                if stream.random() < 0.5:
                    satellite.values[code] = satellite.values[code].with_lock(LOST_LOCK)
            satellite.values[code] = satellite.values[code].plus(slipped.get(key, 0))


def half(observations, value, stream):
    """`R`: R times per signal and hour the half cycle is unknown for 5 s, then resolved.

    While unknown it is flagged, and half of the time the phase is off by half a cycle. Beginning
    and resolution are reported as a loss of lock.
    """
    per_second, unknown = float(value) / 3600.0, {}
    for epoch, satellite, elapsed_s in _by_satellite(observations):
        for code in satellite.of_kind("L"):
            key, flags = (satellite.name, code), 0
            if key in unknown and unknown[key][0] <= epoch.time:
                del unknown[key]
                flags = LOST_LOCK
            elif key not in unknown and stream.random() < per_second * elapsed_s:
                unknown[key] = epoch.time + HALF_CYCLE_S, stream.choice([0.0, 0.5])
                flags = LOST_LOCK
            if key in unknown:
                flags |= HALF_CYCLE
                satellite.values[code] = satellite.values[code].plus(unknown[key][1])
            if flags:
                satellite.values[code] = satellite.values[code].with_lock(flags)


def steps(observations, _value, _stream):
    """The receiver's clock goes one millisecond forward every 97 s; tags stay.

    A clock that is Δ ahead measures Δ earlier: P' = P − Ṗ·Δ + c·Δ. Phases run on through the step:
    λφ' = λφ − Ṗ·Δ. A satellite whose range rate is unknown is left out.
    """
    start, last = observations.epochs[0].time, {}
    for epoch in observations.epochs:
        ahead_s = CLOCK_STEP_S * ((epoch.time - start) // CLOCK_STEP_EVERY_S)
        kept = []
        for satellite in epoch.satellites:
            rate_m_s = _range_rate(observations, satellite, epoch.time, last)
            if rate_m_s is None and 0.0 < ahead_s:
                continue
            earlier_m = (rate_m_s or 0.0) * ahead_s
            _delay(satellite, SPEED_OF_LIGHT * ahead_s - earlier_m)
            for code in satellite.of_kind("L"):
                cycles = earlier_m / observations.wavelength_m(satellite.name, code)
                satellite.values[code] = satellite.values[code].plus(-cycles)
            kept.append(satellite)
        epoch.satellites = kept


def _range_rate(observations, satellite, time, last):
    """From Doppler, or else from the undisturbed pseudorange of an epoch at most a minute ago."""
    ranges = satellite.of_kind("C")
    before = last.get(satellite.name)
    if ranges:
        last[satellite.name] = time, satellite.values[ranges[0]].number
    for code in satellite.of_kind("D"):
        return -satellite.values[code].number * observations.wavelength_m(satellite.name, code)
    if ranges and before and 0.0 < time - before[0] <= 60.0:
        return (satellite.values[ranges[0]].number - before[1]) / (time - before[0])
    return None


def gaps(observations, value, stream):
    """`N`: N pauses of 3 to 40 s."""
    first, last, spans = observations.epochs[0].time, observations.epochs[-1].time, []
    for _ in range(int(value)):
        begin = stream.uniform(first, last)
        spans.append((begin, begin + stream.uniform(SHORTEST_GAP_S, LONGEST_GAP_S)))

    def is_kept(epoch):
        return not any(begin <= epoch.time < end for begin, end in spans)

    observations.epochs = [epoch for epoch in observations.epochs if is_kept(epoch)]
    return spans


def _without(letter):
    def leave_out(observations, _value, _stream):
        for _, satellite, _ in _by_satellite(observations):
            for code in satellite.of_kind(letter):
                del satellite.values[code]

    return leave_out


def no_lli(observations, _value, _stream):
    """Without loss-of-lock indicators."""
    for _, satellite, _ in _by_satellite(observations):
        for code, old in satellite.values.items():
            satellite.values[code] = Value(old.number, " ", old.strength)


def shuffle(observations, _value, stream):
    """Changes the order of the satellites in each epoch; repeats one epoch in 50."""
    repeated = []
    for index, epoch in enumerate(observations.epochs):
        stream.shuffle(epoch.satellites)
        repeated += [epoch] * (2 if index % REPEATED_EVERY == REPEATED_EVERY // 2 else 1)
    observations.epochs = repeated


# For each name: the function that applies the fault, and whether the fault takes a value.
CATALOGUE = {
    "cut": (cut, True),
    "thin": (thin, True),
    "cn0-shift": (cn0_shift, True),
    "cn0-scale": (cn0_scale, True),
    "bad-start": (bad_start, True),
    "blackout": (blackout, True),
    "reflect": (reflect, True),
    "jump": (jump, True),
    "wild": (wild, True),
    "slips": (slips, True),
    "half": (half, True),
    "steps": (steps, False),
    "gaps": (gaps, True),
    "no-cn0": (_without("S"), False),
    "no-doppler": (_without("D"), False),
    "no-phase": (_without("L"), False),
    "no-lli": (no_lli, False),
    "shuffle": (shuffle, False),
}

"""Percentiles, bootstrap intervals, recovery times, episodes."""

import itertools
import math
import random
from dataclasses import dataclass

# A position counts as recovered if it and all positions for this time after it are near (s).
STAYS_S = 5.0
# A recovery that takes longer has failed (s). If the recording ends earlier, it is unknown.
ASKED_S = 30.0
# An interval longer than this many usual intervals is a pause of the receiver.
PAUSE_INTERVALS = 2.0
# Length of an episode (s). Errors within one episode are not independent of each other.
EPISODE_S = 30.0
# Chi-square of two degrees of freedom at 95 %.
ELLIPSE_95 = -2.0 * math.log(0.05)
ROUNDS = 1000


def percentile(values, percent):
    """The percentile, linear between order statistics; None without values."""
    if not values:
        return None
    ordered = sorted(values)
    index = (len(ordered) - 1) * percent / 100.0
    low = math.floor(index)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (index - low)


def error_summary(errors):
    """Mean, 50 %, 95 % and maximum; None without values."""
    if not errors:
        return None
    middle, most = percentile(errors, 50.0), percentile(errors, 95.0)
    mean = math.fsum(errors) / len(errors)
    return {"n": len(errors), "mean": mean, "p50": middle, "p95": most, "max": max(errors)}


def ratio_interval(clusters, seed, rounds=ROUNDS):
    """Percentile-bootstrap interval (95 %) of Σa/Σb over clusters (a, b) drawn with replacement.

    Clusters are what is independent: drives, or episodes of one drive. None where fewer than two
    are left or a draw has Σb = 0.

    Source: Efron & Tibshirani (1993), *An Introduction to the Bootstrap*, chapters 13 and 8.
    """
    filled = [cluster for cluster in clusters if any(cluster)]
    if len(filled) < 2:
        return None
    stream, ratios = random.Random(seed), []
    for _ in range(rounds):
        drawn = stream.choices(filled, k=len(filled))
        above, below = math.fsum(a for a, _ in drawn), math.fsum(b for _, b in drawn)
        if below <= 0.0:
            return None
        ratios.append(above / below)
    return percentile(ratios, 2.5), percentile(ratios, 97.5)


def episode(time):
    """The number of the episode that a time lies in."""
    return math.floor(time / EPISODE_S)


def runs_of(times, longest_gap_s):
    """The stretches (first, last) of times without a gap longer than the given one."""
    stretches = []
    for time in sorted(times):
        if stretches and time - stretches[-1][1] <= longest_gap_s:
            stretches[-1] = stretches[-1][0], time
        else:
            stretches.append((time, time))
    return stretches


def normalised_square(east, north, covariance, truth_sigma_m):
    """eᵀΣ⁻¹e of a horizontal error. Σ includes the truth's variance; None if Σ is singular."""
    own = truth_sigma_m**2
    var_e, var_n, cov = covariance[0] + own, covariance[1] + own, covariance[2]
    determinant = var_e * var_n - cov * cov
    if determinant <= 0.0:
        return None
    return (var_n * east**2 - 2.0 * cov * east * north + var_e * north**2) / determinant


@dataclass(frozen=True)
class Sample:
    """One epoch after a fault: its time, whether it counts, whether it is back (None: unknown)."""

    time: float
    counts: bool
    is_back: bool | None


def recovery_s(samples, end):
    """Seconds from a fault's end until the answers are back, and stay so for 5 s.

    Only intervals before epochs that count (five satellites in view) are added up, without
    pauses. None if no epoch after the end is known, or if the recording ends before `ASKED_S`.
    Infinite if the answers are never back.
    """
    later = [sample for sample in samples if end <= sample.time]
    if all(sample.is_back is None for sample in later):
        return None
    longest_s = PAUSE_INTERVALS * _usual_interval_s(samples)
    passed, before = 0.0, end
    for index, sample in enumerate(later):
        interval_s = sample.time - before
        if sample.counts and interval_s <= longest_s:
            passed += interval_s
        before = sample.time
        if sample.is_back and _stays_back(later, index):
            return passed
    return math.inf if ASKED_S <= passed else None


def _usual_interval_s(samples):
    """The median interval; infinite with fewer than two samples."""
    intervals = [after.time - sample.time for sample, after in itertools.pairwise(samples)]
    return percentile(intervals, 50.0) if intervals else math.inf


def _stays_back(samples, index):
    end = samples[index].time + STAYS_S
    following = [sample for sample in samples[index:] if sample.time <= end]
    return all(sample.is_back is not False for sample in following)

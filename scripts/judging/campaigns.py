"""Which runs a campaign consists of."""

from . import rinex
from .runs import Job, Method

# Each fault of the catalogue at a strength that a receiver may meet; `docs/judge.md` says why.
FAULTS = (
    "thin=5", "cn0-shift=-8", "cn0-shift=8", "cn0-scale=0.6", "cn0-scale=1.4", "bad-start=20", "bad-start=60",
    "blackout=120:20", "reflect=0.3", "jump=120:50", "wild=0.02", "slips=60", "half=30", "steps", "gaps=5",
    "no-cn0", "no-doppler", "no-phase", "no-lli", "shuffle",
)
# Faults that draw random numbers. The others need only one seed.
DRAWN = ("bad-start", "reflect", "jump", "wild", "slips", "half", "gaps", "shuffle")
SHORT_FAULTS = ("thin=5", "bad-start=20", "blackout=120:20", "jump=120:50", "steps", "shuffle")
SHORT_FAULTY = ("tst-2019", "berlin", "galway-walk")
SHORT_DRIVES = 12
START_EVERY_S = 30.0
START_LENGTH_S = 120.0


class Plan:
    """Makes jobs for some builds and methods."""

    def __init__(self, builds, methods=None, profiles=("general",)):
        self.builds, self.methods, self.profiles = tuple(builds), methods, profiles

    def _job(self, recording, campaign, condition, **rest):
        names = self.methods or recording.modes
        methods = [Method.parse(name, profile) for name in names for profile in self.profiles]
        if recording.base is None:
            methods = [method for method in methods if not method.is_relative()]
        return Job(recording, campaign, condition, self.builds, tuple(dict.fromkeys(methods)), **rest)

    def as_is(self, recordings):
        return [self._job(recording, "as is", "as is") for recording in recordings]

    def disturbed(self, recordings, texts, seeds):
        """Each fault with each seed on each recording that is RINEX 3."""
        jobs = []
        for recording in filter(_takes_faults, recordings):
            for text in texts:
                names = {part.split("=")[0] for part in text.split()}
                needed = seeds if names & set(DRAWN) else seeds[:1]
                jobs += [self._disturbed(recording, text, seed) for seed in needed]
        return jobs

    def _disturbed(self, recording, text, seed):
        faults = tuple(text.split())
        return self._job(recording, "faults", text, faults=faults, seed=seed, variant=f"seed {seed}")

    def jackknife(self, recordings, pairs=False):
        """Leaves out each satellite, or each pair, and each constellation, one job for each."""
        jobs = []
        for recording in recordings:
            names = _satellites(recording)
            for name in names:
                jobs.append(self._less(recording, "one satellite less", [name]))
            if pairs:
                both = [[a, b] for i, a in enumerate(names) for b in names[i + 1 :]]
                jobs += [self._less(recording, "two satellites less", pair) for pair in both]
            systems = sorted({name[0] for name in names})
            if len(systems) < 2:
                continue
            for system in systems:
                kept = [other for other in systems if other != system]
                jobs.append(self._only(recording, "one constellation less", kept))
                jobs.append(self._only(recording, "one constellation", [system]))
        return jobs

    def _only(self, recording, condition, systems):
        names = ",".join(systems)
        return self._job(recording, "jackknife", condition, settings=(f"systems={names}",), variant=f"only {names}")

    def _less(self, recording, condition, names):
        left_out = ",".join(names)
        settings = (f"exclude_satellites={left_out}",)
        return self._job(recording, "jackknife", condition, settings=settings, variant=f"without {left_out}")

    def starts(self, recordings, every_s=START_EVERY_S, length_s=START_LENGTH_S):
        """A cold start every 30 s, two minutes long."""
        jobs = []
        for recording in recordings:
            begin, end = _span(recording)
            start = begin
            while start + length_s <= end:
                span = start, start + length_s
                variant = f"at {start:.0f}"
                jobs.append(self._job(recording, "starts", "starts", span=span, variant=variant, is_start=True))
                start += every_s
        return jobs


def _takes_faults(recording):
    return recording.rinex3 is not None or _observations(recording) is not None


_read = {}


def _observations(recording):
    """The rover's observations; None where they are not RINEX 3."""
    path = recording.path(recording.rinex3 or recording.rover)
    if path not in _read:
        try:
            _read[path] = rinex.read(path)
        except rinex.UnsupportedFile:
            _read[path] = None
    return _read[path]


def _satellites(recording):
    observations = _observations(recording)
    if observations is None:
        # The RINEX 2 recordings of the table have GPS only: every possible GPS satellite.
        return [f"G{number:02d}" for number in range(1, 33)]
    return observations.satellites()


def _span(recording):
    if recording.span:
        return recording.span
    observations = _observations(recording)
    if observations is None:
        times = recording.truth().times if recording.truth() else []
        return (times[0] % 604_800.0, times[-1] % 604_800.0) if times else (0.0, 0.0)
    times = [epoch.time % 604_800.0 for epoch in observations.epochs]
    return times[0], times[-1]

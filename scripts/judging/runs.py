"""One run of a build on one recording under one condition, and what it measures."""

import hashlib
import os
import subprocess
import tempfile
from array import array
from dataclasses import dataclass, field

from . import faults, measures, rinex
from .positions import Answer, read_answers, to_enu

FIXED = "FIXED"
# Satellites in view that a recovery needs.
RECOVERY_SATELLITES = 5
# A position is back within this distance of the undisturbed run (m): alone, relative to a base.
BACK_ALONE_M, BACK_RELATIVE_M = 3.0, 1.0
# For this time after a fault's end a run need not have the fixes of the undisturbed run (s).
AFTERMATH_S = 60.0
# A fix under a fault is wrong if its error is larger (m, 2D).
WRONG_DISTURBED_M = 0.5
# Lower ends of the classes of stated probability.
CLASSES = (0.0, 0.9, 0.99, 0.999, 0.9999, 0.99999)
# A longer pause ends a stretch of wrong fixes (s).
WRONG_PAUSE_S = 2.0


class RunFailed(Exception):
    """A build refused a recording or failed on it."""


@dataclass(frozen=True)
class Method:
    """A mode, its way (causal, smoothed or batch) and a profile: `fgo:batch@urban-vehicle`."""

    mode: str
    way: str = "causal"
    profile: str = "general"

    @classmethod
    def parse(cls, text, profile="general"):
        mode, _, named = text.partition("@")
        mode, _, way = mode.partition(":")
        return cls(mode, way or "causal", named or profile)

    def __str__(self):
        way = "" if self.way == "causal" else f":{self.way}"
        profile = "" if self.profile == "general" else f"@{self.profile}"
        return f"{self.mode}{way}{profile}"

    def arguments(self):
        way = {"causal": [], "smoothed": ["--smoothed"], "batch": ["--window", "batch"]}[self.way]
        return ["--mode", self.mode, "--profile", self.profile, *way]

    def is_relative(self):
        return self.mode.startswith("rtk")


@dataclass(frozen=True)
class Job:
    """A recording under a condition, for every build and method."""

    recording: object
    # `as is`, `faults`, `jackknife` or `starts`. Ellipses and probabilities are pooled over it.
    campaign: str
    # `as is`, a fault, `one satellite less`, `starts` …. Errors are pooled over it.
    condition: str
    builds: tuple
    methods: tuple
    faults: tuple = ()
    seed: int = 1
    # Options of `solve --set`.
    settings: tuple = ()
    span: tuple | None = None
    # Distinguishes the runs of one condition.
    variant: str = ""
    # Whether recovery is measured from the first epoch on, as after a cold start.
    is_start: bool = False


@dataclass
class Run:
    """The result of one build and method in a job."""

    build: str
    recording: str
    kind: str
    is_compared: bool
    campaign: str
    condition: str
    variant: str
    method: str
    epochs: int = 0
    answered: int = 0
    cpu_s: float = 0.0
    # Horizontal errors (m) of all answered epochs. `single` has the epochs that single points also
    # answer: the errors of the run, and those of single points. `undisturbed` has the epochs that
    # the undisturbed run also answers: the errors of both.
    errors: array = field(default_factory=lambda: array("d"))
    single: tuple = field(default_factory=lambda: (array("d"), array("d")))
    undisturbed: tuple = field(default_factory=lambda: (array("d"), array("d")))
    # By episode: Σ error, Σ error of single points.
    against_single: dict = field(default_factory=dict)
    fixed: int = 0
    judged_fixes: int = 0
    wrong: int = 0
    # Number of stretches of wrong fixes.
    wrong_stretches: int = 0
    # By status and episode: the number of judged epochs, of those inside the ellipse, Σ of half the
    # normalised square, the number with a protection level, and of those that exceeded it.
    stated: dict = field(default_factory=dict)
    # By class of stated probability and episode: fixes, wrong fixes, Σ of the stated risk.
    reliability: dict = field(default_factory=dict)
    recovery_s: float | None = None
    # The recovery of a run whose answers are all the truth: the undisturbed run may be wrong.
    truth_recovery_s: float | None = None
    refixed_s: float | None = None
    # Right fixes of the undisturbed run outside fault and aftermath; how many this run has, too.
    fixes_before: int = 0
    fixes_kept: int = 0
    failure: str | None = None


def execute(job, scratch):
    """Runs a job. Returns a run for each build and method."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        rover, disturbance = _rover(job, folder)
        runs = []
        for build in job.builds:
            solver = _Solver(job, build, rover, folder, scratch)
            try:
                single = solver.solve(Method("spp"))
            except RunFailed as failure:
                single = [], 0.0
                runs.append(_new_run(job, build, Method("spp"), str(failure)))
            for method in job.methods:
                runs.append(_run(job, build, method, solver, single, disturbance))
        return runs


def _new_run(job, build, method, failure=None):
    one = job.recording
    return Run(
        build[0], one.name, one.kind, one.is_compared, job.campaign, job.condition, job.variant, str(method),
        failure=failure,
    )


@dataclass
class _Disturbance:
    """Spans of a fault, and how many satellites each epoch of the disturbed file has."""

    spans: list
    in_view: dict | None

    def is_disturbed(self, time):
        return any(begin <= time < end + AFTERMATH_S for begin, end in self.spans)


def _rover(job, folder):
    """The rover's file as the job disturbs it."""
    recording = job.recording
    if not job.faults:
        return recording.path(recording.rover), _Disturbance([], None)
    observations = rinex.read(recording.path(recording.rinex3 or recording.rover))
    span = job.span or recording.span
    if span:
        week = observations.epochs[0].time // 604_800.0 * 604_800.0
        begin, end = (week + second for second in span)
        observations.epochs = [one for one in observations.epochs if begin <= one.time <= end]
    changed, spans = faults.inject(observations, job.faults, job.seed)
    path = os.path.join(folder, "rover.obs")
    rinex.write(path, changed)
    in_view = {round(one.time, 3): one.ranged() for one in changed.epochs}
    return path, _Disturbance(spans, in_view)


class _Solver:
    """Runs one build on the files of a job."""

    def __init__(self, job, build, rover, folder, scratch):
        self.job, self.build, self.rover = job, build, rover
        self.folder, self.scratch = folder, scratch

    def solve(self, method):
        """Answers, and the processor time taken (s)."""
        output = os.path.join(self.folder, "answers.csv")
        cpu_s = self._call(method, self.rover, self.job.settings, self.job.span, output)
        return read_answers(output), cpu_s

    def undisturbed(self, method):
        """Answers for the whole recording without fault or option; computed once for all jobs."""
        recording = self.job.recording
        name = hashlib.blake2b(
            repr((self.build, recording.folder, recording.name, method)).encode(), digest_size=12,
        ).hexdigest()
        path = os.path.join(self.scratch, f"{name}.csv")
        if not os.path.exists(path):
            own = os.path.join(self.folder, "undisturbed.csv")
            self._call(method, recording.path(recording.rover), (), None, own)
            os.replace(own, path)
        return read_answers(path)

    def _call(self, method, rover, settings, span, output):
        recording = self.job.recording
        command = [self.build[1], "solve", *method.arguments(), "--rover", rover, "--nav"]
        command += [recording.path(name) for name in recording.navigation]
        if method.is_relative():
            position = ",".join(f"{value:.4f}" for value in recording.base_position)
            command += ["--base", recording.path(recording.base), f"--base-position={position}"]
        if span or recording.span:
            begin, end = span or recording.span
            command += [f"--from={begin}", f"--to={end}"]
        for setting in settings:
            command += ["--set", setting]
        process = subprocess.Popen(
            [*command, "--output", output], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )
        message = process.stderr.read()
        process.stderr.close()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise RunFailed(f"{method} on {recording.name}: {message.strip()[-300:]}")
        return usage.ru_utime + usage.ru_stime


def _run(job, build, method, solver, single, disturbance):
    run = _new_run(job, build, method)
    try:
        answers, run.cpu_s = single if method == Method("spp") else solver.solve(method)
        is_plain = job.campaign == "as is"
        before = answers if is_plain else solver.undisturbed(method)
    except RunFailed as failure:
        run.failure = str(failure)
        return run
    truth = job.recording.truth()
    wrong_m = max(job.recording.wrong_m, WRONG_DISTURBED_M) if job.faults else job.recording.wrong_m
    judge = _Judge(run, truth, wrong_m, job.recording.truth_sigma_m)
    judge.count(answers)
    if truth:
        judge.compare(answers, single[0], run.single, run.against_single)
        judge.compare(answers, before, run.undisturbed, {})
    if not is_plain:
        _judge_recovery(run, job, method, answers, before, disturbance, truth)
        _judge_kept(run, judge, answers, before, disturbance)
    return run


class _Judge:
    """Measures answers against the truth."""

    def __init__(self, run, truth, wrong_m, truth_sigma_m):
        self.run, self.truth = run, truth
        self.wrong_m, self.truth_sigma_m = wrong_m, truth_sigma_m

    def error(self, answer):
        """East, north; None without position or truth."""
        place = self.truth and answer.place and self.truth.at(answer.time)
        return to_enu(answer.place, place)[:2] if place else None

    def is_wrong(self, error):
        return self.wrong_m < (error[0] ** 2 + error[1] ** 2) ** 0.5

    def count(self, answers):
        run, wrong_times = self.run, []
        for answer in answers:
            if self.truth and self.truth.at(answer.time) is None:
                continue
            run.epochs += 1
            if answer.place is None:
                continue
            run.answered += 1
            run.fixed += answer.status == FIXED
            error = self.error(answer)
            if error is None:
                continue
            run.errors.append((error[0] ** 2 + error[1] ** 2) ** 0.5)
            self._count_stated(answer, error)
            if answer.status == FIXED:
                run.judged_fixes += 1
                self._count_fix(answer, error)
                if self.is_wrong(error):
                    wrong_times.append(answer.time)
        run.wrong = len(wrong_times)
        run.wrong_stretches = len(measures.runs_of(wrong_times, WRONG_PAUSE_S))

    def _count_stated(self, answer, error):
        if answer.covariance is None:
            return
        square = measures.normalised_square(*error, answer.covariance, self.truth_sigma_m)
        if square is None:
            return
        of_status = self.run.stated.setdefault(answer.status, {})
        sums = of_status.setdefault(measures.episode(answer.time), [0, 0, 0.0, 0, 0])
        sums[0] += 1
        sums[1] += square <= measures.ELLIPSE_95
        sums[2] += 0.5 * square
        if answer.protection:
            sums[3] += 1
            sums[4] += answer.protection[0] < (error[0] ** 2 + error[1] ** 2) ** 0.5

    def _count_fix(self, answer, error):
        if answer.probability is None:
            return
        lowest = max(low for low in CLASSES if low <= answer.probability)
        of_class = self.run.reliability.setdefault(lowest, {})
        sums = of_class.setdefault(measures.episode(answer.time), [0, 0, 0.0])
        sums[0] += 1
        sums[1] += self.is_wrong(error)
        sums[2] += 1.0 - answer.probability

    def compare(self, answers, others, pairs, episodes):
        """Adds the errors of both, where both answer, to `pairs` and to the episodes."""
        other_of = {answer.time: answer for answer in others}
        for answer in answers:
            other = other_of.get(answer.time)
            errors = [self.error(one) for one in (answer, other) if one]
            if len(errors) < 2 or None in errors:
                continue
            own, its = ((east**2 + north**2) ** 0.5 for east, north in errors)
            pairs[0].append(own)
            pairs[1].append(its)
            sums = episodes.setdefault(measures.episode(answer.time), [0.0, 0.0])
            sums[0] += own
            sums[1] += its


def _judge_recovery(run, job, method, answers, before, disturbance, truth):
    before_of = {answer.time: answer for answer in before}
    ends = [end for _, end in disturbance.spans]
    if job.is_start and answers:
        ends = [answers[0].time]
    back_m = BACK_RELATIVE_M if method.is_relative() else BACK_ALONE_M

    def sample(answer, is_back):
        in_view = disturbance.in_view
        counts = in_view is None or RECOVERY_SATELLITES <= in_view.get(answer.time, 0)
        return measures.Sample(answer.time, counts, is_back(answer, before_of.get(answer.time)))

    def is_near(answer, other):
        if other is None or other.place is None:
            return None
        if answer.place is None:
            return False
        east, north, _ = to_enu(answer.place, other.place)
        return (east**2 + north**2) ** 0.5 <= back_m

    def is_truth_near(answer, other):
        place = truth.at(answer.time)
        return is_near(Answer(answer.time, answer.status, place), other) if place else None

    def is_refixed(answer, other):
        return answer.status == FIXED if other and other.status == FIXED else None

    run.recovery_s = _worst([sample(answer, is_near) for answer in answers], ends)
    if truth:
        run.truth_recovery_s = _worst([sample(answer, is_truth_near) for answer in answers], ends)
    if method.is_relative():
        run.refixed_s = _worst([sample(answer, is_refixed) for answer in answers], ends)


def _worst(samples, ends):
    times = [measures.recovery_s(samples, end) for end in ends]
    return max((time for time in times if time is not None), default=None)


def _judge_kept(run, judge, answers, before, disturbance):
    status_of = {answer.time: answer.status for answer in answers}
    for answer in before:
        if answer.status != FIXED or answer.time not in status_of:
            continue
        error = judge.error(answer)
        is_right = judge.truth is None or (error is not None and not judge.is_wrong(error))
        if is_right and not disturbance.is_disturbed(answer.time):
            run.fixes_before += 1
            run.fixes_kept += status_of[answer.time] == FIXED

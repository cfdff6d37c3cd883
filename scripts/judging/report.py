"""The tables: runs of one build, condition, recording and method pooled."""

from dataclasses import asdict, dataclass

from . import measures

# Recordings of a hardware simulator, and recordings whose truth comes from the same data. A stated
# covariance does not describe their errors.
NOT_FOR_ELLIPSES = ("spirent", "meijo")
# Ratios of shorter runs are not compared.
FEWEST_EPOCHS = 30
FEWEST_EPISODES = 50
BOOTSTRAP_SEED = 1


@dataclass
class Group:
    """Runs that differ only in their variant."""

    build: str
    condition: str
    recording: str
    method: str
    runs: list

    def summary(self):
        """Everything measured, as JSON has it."""
        runs = self.runs
        single = _pooled_pairs(run.single for run in runs)
        undisturbed = _pooled_pairs(run.undisturbed for run in runs)
        judged = [run for run in runs if FEWEST_EPOCHS <= len(run.single[0])]
        return {
            "build": self.build,
            "condition": self.condition,
            "recording": self.recording,
            "method": self.method,
            "is_compared": runs[0].is_compared,
            "kind": runs[0].kind,
            "runs": len(runs),
            "failures": [run.failure for run in runs if run.failure],
            "epochs": sum(run.epochs for run in runs),
            "answered": sum(run.answered for run in runs),
            "cpu_s": sum(run.cpu_s for run in runs),
            "error": measures.error_summary([error for run in runs for error in run.errors]),
            "single": _comparison(*single),
            "single_interval": measures.ratio_interval(_episodes(runs), BOOTSTRAP_SEED),
            "single_worst": _worst(judged),
            "undisturbed": _comparison(*undisturbed),
            "fixed": sum(run.fixed for run in runs),
            "judged_fixes": sum(run.judged_fixes for run in runs),
            "wrong": sum(run.wrong for run in runs),
            "wrong_stretches": sum(run.wrong_stretches for run in runs),
            "fixes_before": sum(run.fixes_before for run in runs),
            "fixes_kept": sum(run.fixes_kept for run in runs),
            "recovery_s": _worst_and_median([run.recovery_s for run in runs]),
            "recovery_late": _late([run.recovery_s for run in runs]),
            "truth_recovery_late": _late([run.truth_recovery_s for run in runs]),
            "refixed_s": _worst_and_median([run.refixed_s for run in runs]),
        }


def groups(runs):
    """Runs by build, condition, recording and method, in the order of their first appearance."""
    found = {}
    for run in runs:
        key = run.build, run.condition, run.recording, run.method
        found.setdefault(key, Group(*key, [])).runs.append(run)
    return list(found.values())


def _pooled_pairs(pairs):
    own, its = [], []
    for first, second in pairs:
        own += first
        its += second
    return own, its


def _comparison(own, its):
    """Means and 95 % of both, and their ratios; None without errors."""
    if not own:
        return None
    a, b = measures.error_summary(own), measures.error_summary(its)
    return {
        "n": len(own),
        "mean": a["mean"],
        "p95": a["p95"],
        "its_mean": b["mean"],
        "its_p95": b["p95"],
        "mean_ratio": _ratio(a["mean"], b["mean"]),
        "p95_ratio": _ratio(a["p95"], b["p95"]),
    }


def _ratio(above, below):
    return above / below if below else None


def _episodes(runs):
    """Sums of both errors by episode. Variants of one recording have the same episodes."""
    sums = {}
    for run in runs:
        for number, (own, its) in run.against_single.items():
            before = sums.get((run.recording, number), (0.0, 0.0))
            sums[run.recording, number] = before[0] + own, before[1] + its
    return list(sums.values())


def _worst(runs):
    """The run whose mean or 95 % is worst against single points."""
    ratios = []
    for run in runs:
        comparison = _comparison(*run.single)
        found = [comparison["mean_ratio"], comparison["p95_ratio"]]
        ratios.append((max(ratio or 0.0 for ratio in found), run.variant, *found))
    return ratios and dict(zip(("variant", "mean_ratio", "p95_ratio"), max(ratios)[1:])) or None


def _worst_and_median(times):
    known = [time for time in times if time is not None]
    return {"worst": max(known), "median": sorted(known)[len(known) // 2], "n": len(known)} if known else None


def _late(times):
    """The number of times longer than `ASKED_S`."""
    return sum(measures.ASKED_S < time for time in times if time is not None)


def ellipses(runs):
    """By kind, method and status: fraction in the stated 95 % ellipse, half the normalised square.

    The interval is over recordings if there are five, else over episodes.
    """
    sums = {}
    for run in runs:
        if any(run.recording.startswith(name) for name in NOT_FOR_ELLIPSES):
            continue
        for status, episodes in run.stated.items():
            key = run.build, run.campaign, run.kind, run.method, status
            of_key = sums.setdefault(key, {})
            for number, more in episodes.items():
                before = of_key.setdefault((run.recording, number), [0] * len(more))
                of_key[run.recording, number] = [a + b for a, b in zip(before, more)]
    return [_ellipse(key, episodes) for key, episodes in sums.items()]


def _ellipse(key, episodes):
    clusters = _clusters(episodes)
    n, inside, squares, stated, exceeded = (sum(column) for column in zip(*clusters))
    names = "build", "campaign", "kind", "method", "status"
    return {
        **dict(zip(names, key)),
        "n": n,
        "clusters": len(clusters),
        "inside": inside / n,
        "inside_interval": measures.ratio_interval([(c[1], c[0]) for c in clusters], BOOTSTRAP_SEED),
        "normalised": squares / n,
        "protected": stated,
        "exceeded": exceeded / stated if stated else None,
        "exceeded_interval": measures.ratio_interval([(c[4], c[3]) for c in clusters], BOOTSTRAP_SEED),
    }


def _clusters(episodes):
    recordings = {}
    for (recording, _), sums in episodes.items():
        before = recordings.get(recording, [0] * len(sums))
        recordings[recording] = [a + b for a, b in zip(before, sums)]
    return list(recordings.values()) if 5 <= len(recordings) else list(episodes.values())


def reliability(runs):
    """By method and class of stated probability: fixes, wrong, stated risk, by episode."""
    sums = {}
    for run in runs:
        for lowest, episodes in run.reliability.items():
            of_key = sums.setdefault((run.build, run.campaign, run.method, lowest), {})
            for number, more in episodes.items():
                before = of_key.setdefault((run.recording, number), [0] * len(more))
                of_key[run.recording, number] = [a + b for a, b in zip(before, more)]
    rows = []
    for key in sorted(sums):
        episodes = list(sums[key].values())
        fixes, wrong, risk = (sum(column) for column in zip(*episodes))
        names = "build", "campaign", "method", "from"
        rows.append({
            **dict(zip(names, key)),
            "fixes": fixes,
            "episodes": len(episodes),
            "stated": risk / fixes,
            "wrong": wrong / fixes,
            "interval": measures.ratio_interval([(one[1], one[0]) for one in episodes], BOOTSTRAP_SEED),
        })
    return rows


def document(runs, command):
    """The whole report, for JSON. Infinite times are the text `never`."""
    def plain(value):
        if isinstance(value, dict):
            return {str(name): plain(item) for name, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        return "never" if value == float("inf") else value

    kept = [{k: v for k, v in asdict(run).items() if k not in HEAVY} for run in runs]
    return plain({
        "command": command,
        "groups": [group.summary() for group in groups(runs)],
        "ellipses": ellipses(runs),
        "reliability": reliability(runs),
        "runs": [
            {**one, "error": measures.error_summary(list(run.errors)), "single": _comparison(*run.single)}
            for one, run in zip(kept, runs)
        ],
    })


# The fields of a run that its group already contains.
HEAVY = {"errors", "single", "undisturbed", "against_single", "stated", "reliability"}

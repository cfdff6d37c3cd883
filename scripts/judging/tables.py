"""The tables as text, one row a group."""

import math

from .report import FEWEST_EPISODES


def _number(value, digits=2):
    if value is None:
        return "–"
    return "never" if math.isinf(value) else f"{value:.{digits}f}"


def _metres(value):
    """Three significant digits below a metre, centimetres above."""
    return _number(value, 2 if value is None or 1.0 <= value else 3)


def _share(part, whole, digits=1):
    return f"{100.0 * part / whole:.{digits}f} %" if whole else "–"


def _interval(interval, scale=1.0, digits=2):
    return f" [{scale * interval[0]:.{digits}f}, {scale * interval[1]:.{digits}f}]" if interval else ""


def _pair(ratios):
    return f"{_number(ratios.get('mean_ratio'))}/{_number(ratios.get('p95_ratio'))}"


def _print(title, heads, rows):
    """Leaves out columns without information: one build, one run a row, or only dashes."""
    if not rows:
        return
    trivial = {"build": {rows[0][0]}, "runs": {"1"}, "clusters": {"1"}}

    def is_kept(index):
        found = {row[index] for row in rows}
        return not (found <= {"–", "–/–"} or found == trivial.get(heads[index]))

    kept = [index for index in range(len(heads)) if is_kept(index)]
    cells = [[row[index] for index in kept] for row in [heads, *rows]]
    widths = [max(len(row[column]) for row in cells) for column in range(len(kept))]
    print(f"\n{title}\n")
    for index, row in enumerate(cells):
        print("| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths)) + " |")
        if index == 0:
            print("|" + "|".join("-" * (width + 2) for width in widths) + "|")


def _name(summary):
    mark = "" if summary["is_compared"] else " *"
    return [summary["build"], summary["condition"], summary["recording"] + mark, summary["method"]]


NAMES = ["build", "condition", "recording", "method"]


def errors(summaries):
    rows = []
    for one in summaries:
        error, single, before = one["error"] or {}, one["single"] or {}, one["undisturbed"] or {}
        worst = one["single_worst"] or {}
        rows.append([
            *_name(one), str(one["runs"]), str(one["epochs"]), _share(one["answered"], one["epochs"]),
            *(_metres(error.get(name)) for name in ("mean", "p50", "p95", "max")),
            f"{_metres(single.get('its_mean'))}/{_metres(single.get('its_p95'))}",
            _number(single.get("mean_ratio")) + _interval(one["single_interval"]),
            _number(single.get("p95_ratio")),
            _pair(worst) if 1 < one["runs"] else "–",
            "–" if one["condition"] == "as is" else _metres(before.get("its_mean")),
            _number(one["answered"] / one["cpu_s"], 0) if one["cpu_s"] else "–",
        ])
    heads = [
        *NAMES, "runs", "epochs", "answered", "2D mean", "50 %", "95 %", "max", "spp mean/95 %", "mean to spp",
        "95 % to spp", "worst run", "undisturbed", "epochs/CPU s",
    ]
    title = "Horizontal errors (m). `to spp`: over the epochs that both answer; *: not compared on."
    _print(title, heads, rows)


def fixes(summaries):
    rows = []
    for one in summaries:
        if not one["method"].startswith("rtk"):
            continue
        refixed, judged = one["refixed_s"] or {}, one["judged_fixes"]
        rows.append([
            *_name(one), str(one["runs"]), str(one["epochs"]), str(one["fixed"]), _share(one["fixed"], one["epochs"]),
            str(one["wrong"]), _share(one["wrong"], judged, 2), str(one["wrong_stretches"]),
            _share(one["fixes_kept"], one["fixes_before"]), _number(refixed.get("worst"), 0),
        ])
    heads = [
        *NAMES, "runs", "epochs", "fixed", "share", "wrong", "of fixes with truth", "stretches", "kept",
        "fixed again, worst (s)",
    ]
    _print("Fixes.", heads, rows)


def recoveries(summaries):
    rows = [
        [
            *_name(one), str(one["recovery_s"]["n"]), _number(one["recovery_s"]["median"], 0),
            _number(one["recovery_s"]["worst"], 0), str(one["recovery_late"]), str(one["truth_recovery_late"]),
        ]
        for one in summaries
        if one["recovery_s"]
    ]
    title = "Seconds from the fault's end until back at the undisturbed run (3 m, with a base 1 m)."
    _print(title, [*NAMES, "runs", "median", "worst", "beyond 30 s", "truth beyond 30 s"], rows)


def ellipses(entries):
    rows = []
    for one in entries:
        is_protected = one["exceeded"] is not None
        rows.append([
            one["build"], one["campaign"], one["kind"], one["method"], one["status"], str(one["n"]),
            str(one["clusters"]),
            _share(one["inside"], 1.0) + _interval(one["inside_interval"], 100.0, 1),
            _number(one["normalised"]),
            _share(one["exceeded"], 1.0, 3) + _interval(one["exceeded_interval"], 100.0, 3) if is_protected else "–",
        ])
    heads = [
        "build", "campaign", "kind", "method", "status", "epochs", "clusters", "inside 95 %", "normalised square / 2",
        "protection exceeded",
    ]
    _print("Stated ellipses and protection levels.", heads, rows)


def reliability(entries):
    rows = []
    for one in entries:
        mark = "" if FEWEST_EPISODES <= one["episodes"] else " (few)"
        rows.append([
            one["build"], one["campaign"], one["method"], f"{one['from']:g}", str(one["fixes"]),
            str(one["episodes"]) + mark, f"{100.0 * one['stated']:.4f} %",
            f"{100.0 * one['wrong']:.4f} %" + _interval(one["interval"], 100.0, 3),
        ])
    heads = ["build", "campaign", "method", "stated from", "fixes", "episodes", "stated wrong", "realised wrong"]
    _print("Reliability of the stated probability.", heads, rows)


def failures(runs):
    for run in runs:
        if run.failure:
            print(f"failed: {run.build} {run.condition} {run.variant}: {run.failure}")

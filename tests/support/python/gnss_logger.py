"""Pseudoranges of a GnssLogger log by gnss_lib_py, against the RINEX file of the same observations.

gnss_lib_py computes times of reception near 1.3e18 ns in doubles, so that all pseudoranges of an
epoch have a common error of up to 80 m. Differences between satellites are free of it.

Usage: gnss_logger.py LOG RINEX
"""
import collections
import statistics
import sys
import warnings

warnings.filterwarnings("ignore")
from gnss_lib_py.parsers.android import AndroidRawGnss  # noqa: E402

CONSTELLATION_TYPES = {1: "G", 3: "R", 4: "J", 5: "C", 6: "E"}
# Nanoseconds of the log and of the double, twice, in light metres.
TOLERANCE_M = 0.35


def of_rinex(path):
    """Pseudoranges by epoch: satellite and frequency band."""
    codes, epochs = {}, []
    with open(path, encoding="ascii") as file:
        for line in file:
            label = line[60:].strip()
            if label == "SYS / # / OBS TYPES":
                letter = line[0] if line[0] != " " else letter
                codes.setdefault(letter, []).extend(line[7:58].split())
            elif line[0] == ">":
                epochs.append({})
            elif epochs and line[0] in codes:
                for index, code in enumerate(codes[line[0]]):
                    text = line[3 + 16 * index : 17 + 16 * index].strip()
                    if code[0] == "C" and text:
                        epochs[-1][line[:3], code[1:]] = float(text)
    return epochs


def of_log(path):
    """The same by gnss_lib_py; satellites by the log's own numbers."""
    with open(path, encoding="ascii") as file:
        lines = file.read().splitlines()
    title = next(line for line in lines if line.startswith("# Raw,")).split(",")
    rows = [line.split(",") for line in lines if line.startswith("Raw,")]
    column = {name: index for index, name in enumerate(title)}
    ranges = AndroidRawGnss(path, filter_measurements=False)["raw_pr_m"]
    assert len(ranges) == len(rows), (len(ranges), len(rows))
    bands = {1575: "1", 1602: "1", 1227: "2", 1246: "2", 1176: "5", 1207: "7", 1561: "2", 1268: "6"}
    epochs = collections.OrderedDict()
    for row, range_m in zip(rows, ranges):
        letter = CONSTELLATION_TYPES[int(row[column["ConstellationType"]])]
        number = int(row[column["Svid"]]) - (192 if letter == "J" else 0)
        mhz = float(row[column["CarrierFrequencyHz"]]) / 1e6
        band = bands[min(bands, key=lambda known: abs(known + 0.4 - mhz))]
        signal = f"{letter}{number:02d}", band + row[column["CodeType"]]
        epochs.setdefault(row[column["TimeNanos"]], {})[signal] = float(range_m)
    return list(epochs.values())


def main():
    log, rinex = of_log(sys.argv[1]), of_rinex(sys.argv[2])
    assert len(log) == len(rinex), (len(log), len(rinex))
    compared, greatest_m, seen = 0, 0.0, collections.Counter()
    for ours, theirs in zip(rinex, log):
        assert ours.keys() == theirs.keys(), ours.keys() ^ theirs.keys()
        differences = {signal: theirs[signal] - ours[signal] for signal in ours}
        common = statistics.median(differences.values())
        assert abs(common) < 160, common
        for signal, difference in differences.items():
            greatest_m = max(greatest_m, abs(difference - common))
            compared += 1
            seen[signal[0][0]] += 1
    print(f"{compared} pseudoranges of {len(log)} epochs, {dict(seen)}: {greatest_m:.3f} m at most")
    assert seen.keys() >= set("GREC"), seen
    assert greatest_m < TOLERANCE_M, greatest_m


main()

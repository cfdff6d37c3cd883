#!/usr/bin/env python3
"""Counts epochs and signals of plain RINEX observation files, independently of Graphfix.

usage: count_rinex.py FILE...   prints "FILE: E epochs, O observations" per file

Whole file in memory, fields cut by slices, numbers by float(): nothing in common with the reader.
Only for files without broken epochs. A signal counts once per satellite and epoch if any of its
values is neither blank nor zero. RINEX 2 phases count with the pseudorange of their band that is
there (C1 before P1, P2 before C2), as compute/src/formats/rinex/columns.rs defines.
"""
import gzip
import sys

SYSTEMS = "GRECJ"
FIRST = {"1": "CP", "2": "PC"}


def value(line, index, start):
    text = line[start + 16 * index:start + 16 * index + 14].strip()
    return bool(text) and float(text) != 0.0


def signals_3(types, line):
    return {t[1:] for i, t in enumerate(types) if t[0] in "CLDS" and value(line, i, 3)}


def signals_2(system, types, lines):
    text = "".join(line.ljust(80)[:80] for line in lines)
    there = [t for i, t in enumerate(types) if value(text, i, 0)]
    found = set()
    for t in there:
        if not known_2(system, t):
            continue
        if t[0] in "CP":
            found.add(t)
            continue
        order = [k + t[1] for k in FIRST.get(t[1], "C") if known_2(system, k + t[1])]
        listed = [t2 for t2 in order if t2 in types] or order[:1]
        present = [t2 for t2 in listed if t2 in there]
        found.add((present or listed)[0])
    return {"C1 or C2" if system == "C" and t in ("C1", "C2") else t for t in found}


def known_2(system, kind):
    bands = {"G": "125", "R": "12", "E": "15678", "C": "12567", "J": "1256"}[system]
    return kind[1] in bands and (kind[0] != "P" or system in "GR") and kind[0] in "CPLDS"


def count(path):
    opener = gzip.open if path.endswith(".gz") else open
    with opener(path, "rb") as file:
        lines = file.read().decode("latin-1").splitlines()
    version, types, types_of = None, {}, ""
    epochs = observations = at = 0
    in_header, pending = True, 0
    while at < len(lines):
        line, at = lines[at], at + 1
        label = line[60:80].strip()
        if in_header or 0 < pending:
            pending -= not in_header
            if label == "RINEX VERSION / TYPE":
                version, default = int(float(line[:9])), line[40].upper()
            elif label == "SYS / # / OBS TYPES":
                if line[0] != " ":
                    types_of = line[0]
                    types[types_of] = []
                types[types_of] += line[6:60].split()
            elif label == "# / TYPES OF OBSERV":
                if line[:6].strip():
                    types[""] = []
                types[""] += line[6:60].split()
            elif label == "END OF HEADER":
                in_header = False
            continue
        if not line.strip():
            continue
        flag, number = (line[31], line[32:35]) if version > 2 else (line[28], line[29:32])
        number = int(number)
        if flag in "2345":
            pending = number
        elif version > 2:
            body, at = lines[at:at + number], at + number
            if flag == "6":
                continue
            epochs += 1
            for sat in body:
                if sat[0] in SYSTEMS and sat[0] in types:
                    observations += len(signals_3(types[sat[0]], sat))
        else:
            listed = line[32:68]
            for _ in range((number - 1) // 12):
                listed += lines[at][32:68]
                at += 1
            each = -(-len(types[""]) // 5)
            epochs += flag != "6"
            for index in range(number):
                system = listed[3 * index].strip() or (default if default in SYSTEMS else "G")
                body, at = lines[at:at + each], at + each
                if flag != "6" and system in SYSTEMS:
                    observations += len(signals_2(system, types[""], body))
    return f"{path}: {epochs} epochs, {observations} observations"


for argument in sys.argv[1:]:
    print(count(argument))

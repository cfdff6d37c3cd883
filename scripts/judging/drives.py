"""Drives of the simulator, as recordings."""

import os
import re
import subprocess

from .recordings import ALONE, RELATIVE, Recording
from .runs import RunFailed

BASE_POSITION = re.compile(r"antenna at (-?[\d.]+),(-?[\d.]+),(-?[\d.]+)")
KIND = re.compile(r"^kind (\w+):", re.MULTILINE)
# Seeds up to this were looked at while settings were chosen (docs/judge.md).
LAST_COMPARED_SEED = 500


def simulate(simulator, scenario, seed, scratch, options=()):
    """Lets a build simulate one drive into a folder of `scratch`."""
    folder = os.path.join(scratch, f"{scenario}-{seed}")
    command = [simulator, "simulate", "--scenario", scenario, "--seed", str(seed), "--output", folder, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RunFailed(f"{scenario} {seed}: {done.stderr.strip()[-300:]}")
    base, kind = BASE_POSITION.search(done.stdout), KIND.search(done.stdout)
    kind = f"simulated {kind.group(1) if kind else scenario}"
    return Recording(
        f"{scenario}-{seed}", folder, "rover.obs", ("navigation.rnx",), kind, seed <= LAST_COMPARED_SEED,
        base="base.obs" if base else None, base_position=base and tuple(map(float, base.groups())),
        truth_file="truth.csv", modes=ALONE + RELATIVE if base else ALONE,
    )

"""The judge: runs builds of graphfix on real and simulated drives and measures their answers.

It shares nothing with the program but the files that it writes and reads. Standard library only.

| module | holds |
|---|---|
| `recordings` | the table of real recordings: files, base, truth, what was compared on them |
| `drives` | drives of the simulator, as recordings |
| `rinex` | RINEX 3 observations, read and written field by field |
| `faults` | faults with a seed |
| `positions` | solution and truth files, errors east, north, up |
| `measures` | percentiles, bootstrap intervals, recovery times, episodes |
| `runs` | one run of a binary, and what it measures |
| `campaigns` | which runs a campaign consists of |
| `report` | the tables |
"""

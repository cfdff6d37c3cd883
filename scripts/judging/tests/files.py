"""Recordings made for tests."""

from judging.rinex import Epoch, Observations, Satellite, Value

CODES = {"G": ["C1C", "L1C", "D1C", "S1C"], "E": ["C1X", "L1X", "D1X", "S1X"]}
# Seconds of the first epoch; its line.
START = 1_000_000.0
LINE = "> 1980 01 12 13 46 40.0000000  0"


def recording(names=("G01", "G02", "G03", "G04", "E05", "E06"), epochs=200, interval_s=1.0):
    """Ranges of 2·10⁷ m that grow by 100 m/s, C/N0 of 40 dB-Hz, more by one for each satellite."""
    observations = Observations([], CODES)
    for index in range(epochs):
        satellites = [_satellite(name, index * interval_s, order) for order, name in enumerate(names)]
        observations.epochs.append(Epoch(START + index * interval_s, LINE, satellites))
    return observations


def _satellite(name, elapsed_s, order):
    code, phase, doppler, strength = CODES[name[0]]
    wavelength_m = Observations([], CODES).wavelength_m(name, phase)
    range_m = 2e7 + 100.0 * elapsed_s
    values = {
        code: Value(range_m),
        phase: Value(range_m / wavelength_m),
        doppler: Value(-100.0 / wavelength_m),
        strength: Value(40.0 + order),
    }
    return Satellite(name, values)


def series(observations, name, code):
    """Readings of one signal by seconds after the first epoch; None where it is not observed."""
    found = {}
    for epoch in observations.epochs:
        of_name = [one for one in epoch.satellites if one.name == name]
        found[epoch.time - START] = of_name[0].values.get(code) if of_name else None
    return found

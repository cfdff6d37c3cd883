/** The position of a base. */
import type { Base, Ecef } from "../api";
import type { LonLat } from "../map/layers";

const A = 6_378_137;
const F = 1 / 298.257_223_563;

/** Geodetic coordinates on WGS 84, by Bowring's formula: below a millimetre on Earth. */
function geodetic({ xM, yM, zM }: Ecef): LonLat & { heightM: number } {
  const e2 = F * (2 - F);
  const b = A * (1 - F);
  const p = Math.hypot(xM, yM);
  const theta = Math.atan2(zM * A, p * b);
  const lat = Math.atan2(
    zM + (e2 / (1 - e2)) * b * Math.sin(theta) ** 3,
    p - e2 * A * Math.cos(theta) ** 3,
  );
  const n = A / Math.sqrt(1 - e2 * Math.sin(lat) ** 2);
  const heightM = p * Math.cos(lat) + zM * Math.sin(lat) - (A * A) / n;
  return { lon: (Math.atan2(yM, xM) * 180) / Math.PI, lat: (lat * 180) / Math.PI, heightM };
}

export function siteOf(base: Base): (LonLat & { heightM: number }) | undefined {
  return base.site ? geodetic(base.site.antennaReferencePoint) : undefined;
}

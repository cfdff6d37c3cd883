/** What the service says in the page: whether it is built with Parquet. */
const hasParquet = document.querySelector<HTMLMetaElement>('meta[name="graphfix-parquet"]')?.content === "yes";

/** The formats of tracks. */
export const FORMATS = [
  { format: "pos", name: ".pos", meaning: "RTKLIB's solution file" },
  { format: "csv", name: "CSV", meaning: "every value of a solution, with its reasons" },
  { format: "geojson", name: "GeoJSON", meaning: "points with properties and the track as lines, for maps" },
  { format: "kml", name: "KML", meaning: "points and track coloured by status, for Google Earth" },
  { format: "gpx", name: "GPX", meaning: "one track, for GPS programs" },
  { format: "nmea", name: "NMEA", meaning: "GGA, RMC, VTG and GST of each epoch" },
  ...(hasParquet ? [{ format: "parquet", name: "Parquet", meaning: "the columns of CSV, for programs of data analysis" }] : []),
];

/** The format of observations. */
export const RINEX = { format: "rinex", name: "RINEX", meaning: "the rover's observations, for other programs" };

//! A caster's list of streams, the sourcetable.

/// Longest sourcetable that is read (bytes); the largest public one has 300 kB.
pub(super) const TABLE_LIMIT: usize = 4 << 20;
/// Most streams of one table.
const MOUNTPOINTS_LIMIT: usize = 20_000;
const END: &[u8] = b"ENDSOURCETABLE";

/// A stream of a caster: one STR record.
#[derive(Clone, Debug, PartialEq)]
pub struct Mountpoint {
    /// Name of the mountpoint.
    pub name: String,
    /// Description, usually the town.
    pub identifier: String,
    /// Data format, such as `RTCM 3.2`.
    pub format: String,
    /// Message types and their intervals.
    pub details: String,
    /// Constellations, such as `GPS+GLO`.
    pub systems: String,
    /// Latitude and longitude (degrees), often with two decimals.
    pub position_deg: Option<(f64, f64)>,
    /// The caster computes the stream for the rover's position, and needs to receive it.
    pub needs_position: bool,
}

/// The streams of a caster.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sourcetable {
    /// In the order of the table.
    pub mountpoints: Vec<Mountpoint>,
}

impl Sourcetable {
    /// Reads a table. Unknown records are skipped.
    pub(crate) fn parse(text: &[u8]) -> Self {
        let text = String::from_utf8_lossy(text);
        let mountpoints = text.lines().filter_map(mountpoint).take(MOUNTPOINTS_LIMIT).collect();
        Self { mountpoints }
    }

    /// The stream of this name.
    pub fn get(&self, name: &str) -> Option<&Mountpoint> {
        self.mountpoints.iter().find(|mountpoint| mountpoint.name == name)
    }
}

/// Whether the whole table has arrived.
pub(super) fn is_whole(text: &[u8]) -> bool {
    text.windows(END.len()).rev().take(64).any(|window| window == END)
}

/// `STR;mountpoint;identifier;format;details;carrier;systems;network;country;latitude;longitude;
/// nmea;…`
fn mountpoint(line: &str) -> Option<Mountpoint> {
    let fields: Vec<&str> = line.split(';').collect();
    let ["STR", name, identifier, format, details, _, systems, _, _, latitude, longitude, ..] =
        fields[..]
    else {
        return None;
    };
    let degrees = |text: &str, limit: f64| {
        text.trim().parse::<f64>().ok().filter(|degrees| degrees.abs() <= limit)
    };
    Some(Mountpoint {
        name: name.to_owned(),
        identifier: identifier.to_owned(),
        format: format.to_owned(),
        details: details.to_owned(),
        systems: systems.to_owned(),
        position_deg: degrees(latitude, 90.0).zip(degrees(longitude, 360.0)),
        needs_position: fields.get(11).is_some_and(|nmea| nmea.trim() == "1"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_read_and_others_passed_over() {
        let text = b"CAS;a.example;2101;A;B;0;DEU;50.00;8.00\r\n\
            STR;AAAA0;Town;RTCM 3.2;1005(10),1077(1);2;GPS+GLO;NET;IRL;53.28;-9.06;0;0;X;none;B;N;9;\r\n\
            STR;VRS;Net;RTCM 3;1004(1);2;GPS;NET;IRL;0.00;0.00;1;1;X;none;B;N;9;\r\n\
            STR;broken;\r\nSTR;FAR;x;RTCM 3;;2;GPS;N;C;953.28;x;0\r\nENDSOURCETABLE\r\n";
        let table = Sourcetable::parse(text);
        let names: Vec<_> = table.mountpoints.iter().map(|m| m.name.as_str()).collect();
        assert_eq!(names, ["AAAA0", "VRS", "FAR"]);
        let first = table.get("AAAA0").unwrap();
        assert_eq!((first.position_deg, first.needs_position), (Some((53.28, -9.06)), false));
        assert!(table.get("VRS").unwrap().needs_position);
        assert_eq!(table.get("FAR").unwrap().position_deg, None);
        assert!(is_whole(text) && !is_whole(&text[..text.len() - 20]));
    }
}

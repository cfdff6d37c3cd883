//! The columns of `Raw` records, and the fields of one record.

use super::{Cause, GnssLoggerError};

/// The beginning of a record with a measurement.
pub(super) const RAW: &[u8] = b"Raw,";

/// A column that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Column {
    TimeNanos,
    FullBiasNanos,
    Svid,
    State,
    ReceivedSvTimeNanos,
    ConstellationType,
    LeapSecond,
    BiasNanos,
    BiasUncertaintyNanos,
    HardwareClockDiscontinuityCount,
    TimeOffsetNanos,
    ReceivedSvTimeUncertaintyNanos,
    Cn0DbHz,
    BasebandCn0DbHz,
    PseudorangeRate,
    PseudorangeRateUncertainty,
    AccumulatedDeltaRangeState,
    AccumulatedDeltaRange,
    CarrierFrequencyHz,
    CodeType,
}

use Column as C;

/// Every column with its name in the log; the first [`REQUIRED`] must be present.
const COLUMNS: [(Column, &str); 20] = [
    (C::TimeNanos, "TimeNanos"),
    (C::FullBiasNanos, "FullBiasNanos"),
    (C::Svid, "Svid"),
    (C::State, "State"),
    (C::ReceivedSvTimeNanos, "ReceivedSvTimeNanos"),
    (C::ConstellationType, "ConstellationType"),
    (C::LeapSecond, "LeapSecond"),
    (C::BiasNanos, "BiasNanos"),
    (C::BiasUncertaintyNanos, "BiasUncertaintyNanos"),
    (C::HardwareClockDiscontinuityCount, "HardwareClockDiscontinuityCount"),
    (C::TimeOffsetNanos, "TimeOffsetNanos"),
    (C::ReceivedSvTimeUncertaintyNanos, "ReceivedSvTimeUncertaintyNanos"),
    (C::Cn0DbHz, "Cn0DbHz"),
    (C::BasebandCn0DbHz, "BasebandCn0DbHz"),
    (C::PseudorangeRate, "PseudorangeRateMetersPerSecond"),
    (C::PseudorangeRateUncertainty, "PseudorangeRateUncertaintyMetersPerSecond"),
    (C::AccumulatedDeltaRangeState, "AccumulatedDeltaRangeState"),
    (C::AccumulatedDeltaRange, "AccumulatedDeltaRangeMeters"),
    (C::CarrierFrequencyHz, "CarrierFrequencyHz"),
    (C::CodeType, "CodeType"),
];
const REQUIRED: usize = 6;

impl Column {
    /// The name in the log.
    pub(super) const fn name(self) -> &'static str {
        COLUMNS[self as usize].1
    }
}

/// Which column each field of a record belongs to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Columns {
    /// By index of the field, from the record's kind on; `None` for a column that is not read.
    fields: Vec<Option<Column>>,
}

/// Whether a line is the comment that names the columns of `Raw` records.
pub(super) fn is_title(line: &[u8]) -> bool {
    title(line).is_some()
}

/// The title after its comment sign and blanks.
fn title(line: &[u8]) -> Option<&[u8]> {
    let text = line.strip_prefix(b"#")?.trim_ascii();
    text.starts_with(RAW).then_some(text)
}

impl Columns {
    /// The columns that line number `number` names; `None` if it is not a title.
    pub(super) fn of_line(line: &[u8], number: u64) -> Result<Option<Self>, GnssLoggerError> {
        let Some(title) = title(line) else { return Ok(None) };
        let column = |name: &[u8]| {
            let named = |(_, known): &&(Column, &str)| known.as_bytes() == name.trim_ascii();
            COLUMNS.iter().find(named).map(|(column, _)| *column)
        };
        let fields: Vec<_> = title.split(|byte| *byte == b',').map(column).collect();
        match COLUMNS[..REQUIRED].iter().find(|(column, _)| !fields.contains(&Some(*column))) {
            Some((_, column)) => Err(GnssLoggerError::MissingColumn { line: number, column }),
            None => Ok(Some(Self { fields })),
        }
    }

    /// The fields of a record.
    pub(super) fn row<'a>(&self, record: &'a [u8]) -> Row<'a> {
        let mut row = Row { fields: [&[]; COLUMNS.len()] };
        for (column, field) in self.fields.iter().zip(record.split(|byte| *byte == b',')) {
            // Version 2.0.0.1 names CarrierFrequencyHz twice: the first one that is filled counts.
            if let Some(column) = column
                && row.fields[*column as usize].is_empty()
            {
                row.fields[*column as usize] = field.trim_ascii();
            }
        }
        row
    }
}

/// One record: the field of each column, empty where blank or absent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<'a> {
    fields: [&'a [u8]; COLUMNS.len()],
}

impl Row<'_> {
    /// The text of a field; `None` if blank.
    pub(super) fn text(&self, column: Column) -> Option<&[u8]> {
        let field = self.fields[column as usize];
        (!field.is_empty()).then_some(field)
    }

    /// An integer; `None` if blank.
    pub(super) fn integer(&self, column: Column) -> Result<Option<i64>, Cause> {
        let Some(text) = self.text(column) else { return Ok(None) };
        let parsed = str::from_utf8(text).ok().and_then(|text| text.parse().ok());
        parsed.map(Some).ok_or(Cause::NotANumber { column: column.name() })
    }

    /// An integer that must be present.
    pub(super) fn required(&self, column: Column) -> Result<i64, Cause> {
        self.integer(column)?.ok_or(Cause::Blank { column: column.name() })
    }

    /// A number of magnitude at most `largest`; `None` if blank or `NaN`, as Java writes a number
    /// that is not set.
    pub(super) fn number(&self, column: Column, largest: f64) -> Result<Option<f64>, Cause> {
        let Some(text) = self.text(column) else { return Ok(None) };
        let parsed = str::from_utf8(text).ok().and_then(|text| text.parse::<f64>().ok());
        match parsed {
            None => Err(Cause::NotANumber { column: column.name() }),
            Some(value) if value.is_nan() => Ok(None),
            Some(value) if largest < value.abs() => {
                Err(Cause::OutOfRange { column: column.name() })
            }
            Some(value) => Ok(Some(value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: &str =
        "# Raw,Svid,State, TimeNanos,FullBiasNanos,ReceivedSvTimeNanos,ConstellationType";

    #[test]
    fn the_title_gives_order_and_names() {
        for (index, (column, _)) in COLUMNS.iter().enumerate() {
            assert_eq!(*column as usize, index);
        }
        let columns = Columns::of_line(LEAST.as_bytes(), 9).unwrap().unwrap();
        let row = columns.row(b"Raw,7,1, 30,-40,50,1,other");
        assert_eq!(row.required(C::Svid), Ok(7));
        assert_eq!(row.required(C::TimeNanos), Ok(30));
        assert_eq!(row.required(C::FullBiasNanos), Ok(-40));
        assert_eq!(row.integer(C::LeapSecond), Ok(None));
        assert_eq!(columns.row(b"Raw,7").required(C::State), Err(Cause::Blank { column: "State" }));
    }

    #[test]
    fn a_missing_column_is_named() {
        let title = LEAST.replace("State", "Staat");
        let error = Columns::of_line(title.as_bytes(), 9).unwrap_err();
        assert_eq!(error.to_string(), "line 9: no column is named State");
        for comment in ["# Raw GNSS measurements format:", "Raw,1", "# Fix,Provider"] {
            assert_eq!(Columns::of_line(comment.as_bytes(), 1), Ok(None));
        }
    }

    #[test]
    fn the_second_column_of_a_name_fills_the_first() {
        let title = format!("{LEAST},CarrierFrequencyHz,AgcDb,CarrierFrequencyHz");
        let columns = Columns::of_line(title.as_bytes(), 1).unwrap().unwrap();
        let frequency =
            |row: &str| columns.row(row.as_bytes()).number(C::CarrierFrequencyHz, 1e10).unwrap();
        assert_eq!(frequency("Raw,1,1,1,1,1,1,,3,1.57542E9"), Some(1.57542e9));
        assert_eq!(frequency("Raw,1,1,1,1,1,1,5,3,6"), Some(5.0));
    }

    #[test]
    fn numbers_as_java_writes_them() {
        let columns = Columns::of_line(format!("{LEAST},Cn0DbHz").as_bytes(), 1).unwrap().unwrap();
        let number = |field: &str| {
            let record = format!("Raw,1,1,1,1,1,1,{field}");
            columns.row(record.as_bytes()).number(C::Cn0DbHz, 100.0)
        };
        assert_eq!(number("1.5E1"), Ok(Some(15.0)));
        assert_eq!(number("NaN"), Ok(None));
        assert_eq!(number("-Infinity"), Err(Cause::OutOfRange { column: "Cn0DbHz" }));
        assert_eq!(number("4o"), Err(Cause::NotANumber { column: "Cn0DbHz" }));
    }
}

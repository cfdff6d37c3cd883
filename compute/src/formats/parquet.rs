//! Solutions as an Apache Parquet file, for programs of data analysis: one row for each epoch, also
//! without a position.
//!
//! The columns have the names, units and meaning of those in [`super::csv`], unrounded, with one
//! more: `time_utc`, the receiver's time tag as a timestamp in UTC (µs). Unknown values are null.
//! Rows are written in groups, so a file of any length needs the memory of one group. Nothing is
//! compressed.

use std::sync::Arc;

use nalgebra::Matrix3;
use parquet::basic::{LogicalType, Repetition, TimeUnit, Type as PhysicalType};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::Type;

use super::csv::{COLUMNS, FRAME_COLUMNS, GEOID_COLUMN, STORED_COLUMNS, reasons_text};
use super::encoder::{Additions, Encoder, Revision};
use crate::gnss::{LeapSeconds, LocalFrame, Presented, SolutionEstimate};

/// Rows of a group.
const GROUP_ROWS: usize = 4096;
/// Memory of a group that is being written (bytes): its values, and their encoded form.
pub(crate) const GROUP_BYTES: usize = 8 << 20;
const TIME_COLUMN: &str = "time_utc";
/// Columns with whole numbers and with texts; the others have fractions.
const INTEGERS: [&str; 7] =
    ["seq", "revision", "gps_week", TIME_COLUMN, "satellites", "ambiguities", "fixed_ambiguities"];
const TEXTS: [&str; 4] = ["status", "satellite_list", "reasons", "frame"];
const NS_PER_S: f64 = 1e9;

/// Writes Parquet.
pub(super) struct Table {
    additions: Additions,
    leap: LeapSeconds,
    /// `None` before the beginning and after the end.
    file: Option<SerializedFileWriter<Vec<u8>>>,
    columns: Vec<Column>,
    rows: usize,
}

/// The values of a column in the present group, and for each row whether it has one.
struct Column {
    name: &'static str,
    values: Values,
    levels: Vec<i16>,
}

enum Values {
    Integers(Vec<i64>),
    Fractions(Vec<f64>),
    Texts(Vec<ByteArray>),
}

impl Table {
    pub(super) fn new(leap: LeapSeconds, additions: Additions) -> Self {
        let Additions { is_stored, has_frame, has_geoid } = additions;
        let titles = [
            (is_stored, STORED_COLUMNS),
            (true, TIME_COLUMN),
            (true, COLUMNS),
            (has_frame, FRAME_COLUMNS),
            (has_geoid, GEOID_COLUMN),
        ];
        let names = titles.into_iter().filter(|(is_there, _)| *is_there);
        let names = names.flat_map(|(_, titles)| titles.split(',')).filter(|name| !name.is_empty());
        let columns = names.map(Column::new).collect();
        Self { additions, leap, file: None, columns, rows: 0 }
    }

    /// Writes the rows that are waiting as a group.
    fn write_group(&mut self, out: &mut Vec<u8>) {
        let Some(file) = self.file.as_mut().filter(|_| 0 < self.rows) else { return };
        let columns = &mut self.columns;
        let written = (|| {
            let mut group = file.next_row_group()?;
            for column in columns {
                let writer = group.next_column()?.expect("the schema has the columns");
                column.write(writer)?;
            }
            group.close().map(drop)
        })();
        written.expect("values fit their columns, and a Vec<u8> takes every byte");
        self.rows = 0;
        take(file, out);
    }
}

/// Moves what is written into the buffer of the caller. Positions in the file go on.
fn take(file: &mut SerializedFileWriter<Vec<u8>>, out: &mut Vec<u8>) {
    file.flush().expect("a Vec<u8> takes every byte");
    out.append(file.inner_mut());
}

impl Encoder for Table {
    fn begin(&mut self, out: &mut Vec<u8>) {
        let fields = self.columns.iter().map(Column::field).collect();
        let schema = Type::group_type_builder("solutions").with_fields(fields).build();
        let schema = schema.expect("the columns have different names");
        let properties = WriterProperties::builder()
            .set_created_by(format!("graphfix {}", env!("CARGO_PKG_VERSION")))
            .set_statistics_enabled(EnabledStatistics::Chunk)
            .set_max_row_group_row_count(Some(GROUP_ROWS))
            .build();
        let file = SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties));
        take(self.file.insert(file.expect("a Vec<u8> takes every byte")), out);
    }

    fn push(&mut self, presented: &Presented<'_>, revision: Option<Revision>, out: &mut Vec<u8>) {
        let Additions { is_stored, has_frame, has_geoid } = self.additions;
        let solution = &presented.solution;
        let mut row = Row { columns: self.columns.iter_mut() };
        if is_stored {
            row.integer(revision.map(|revision| revision.seq as i64));
            row.integer(revision.map(|revision| i64::from(revision.revision)));
        }
        let sub_ms_us = solution.time.ns_of_week().rem_euclid(1_000_000) / 1000;
        row.integer(Some(solution.time.to_unix_ms(&self.leap) * 1000 + sub_ms_us));
        row.integer(Some(i64::from(solution.time.week())));
        row.fraction(Some(solution.time.ns_of_week() as f64 / NS_PER_S));
        row.text(Some(solution.status.name()));
        row.estimate(solution.estimate.as_ref());
        row.text(Some(&*reasons_text(presented)).filter(|text| !text.is_empty()));
        let protection = solution.protection.as_ref();
        row.fraction(protection.map(|levels| levels.horizontal_m));
        row.fraction(protection.map(|levels| levels.vertical_m));
        let has_position = solution.estimate.is_some();
        if has_frame {
            let frame = has_position.then(|| presented.frame_of_position());
            row.text(frame.map(|frame| frame.name));
            row.fraction(frame.and_then(|frame| frame.epoch_year));
        }
        if has_geoid {
            row.fraction(presented.orthometric_height_m());
        }
        self.rows += 1;
        if GROUP_ROWS <= self.rows {
            self.write_group(out);
        }
    }

    fn finish(&mut self, out: &mut Vec<u8>) {
        self.write_group(out);
        if let Some(file) = self.file.take() {
            out.append(&mut file.into_inner().expect("a Vec<u8> takes every byte"));
        }
    }
}

impl Column {
    fn new(name: &'static str) -> Self {
        let values = match name {
            integer if INTEGERS.contains(&integer) => Values::Integers(Vec::new()),
            text if TEXTS.contains(&text) => Values::Texts(Vec::new()),
            _ => Values::Fractions(Vec::new()),
        };
        Self { name, values, levels: Vec::new() }
    }

    /// Its type in the schema.
    fn field(&self) -> Arc<Type> {
        let (physical, logical) = match self.values {
            Values::Integers(_) if self.name == TIME_COLUMN => {
                (PhysicalType::INT64, Some(LogicalType::timestamp(true, TimeUnit::MICROS)))
            }
            Values::Integers(_) => (PhysicalType::INT64, None),
            Values::Fractions(_) => (PhysicalType::DOUBLE, None),
            Values::Texts(_) => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let field = Type::primitive_type_builder(self.name, physical);
        let field = field.with_repetition(Repetition::OPTIONAL).with_logical_type(logical);
        Arc::new(field.build().expect("the types fit each other"))
    }

    /// Writes the values of a group, and forgets them.
    fn write(&mut self, mut writer: SerializedColumnWriter<'_>) -> Result<(), ParquetError> {
        let levels = Some(&self.levels[..]);
        match &mut self.values {
            Values::Integers(values) => {
                writer.typed::<Int64Type>().write_batch(values, levels, None)?;
                values.clear();
            }
            Values::Fractions(values) => {
                writer.typed::<DoubleType>().write_batch(values, levels, None)?;
                values.clear();
            }
            Values::Texts(values) => {
                writer.typed::<ByteArrayType>().write_batch(values, levels, None)?;
                values.clear();
            }
        }
        self.levels.clear();
        writer.close()
    }
}

/// A row that is being filled, from its first column on.
struct Row<'a> {
    columns: std::slice::IterMut<'a, Column>,
}

impl Row<'_> {
    fn next(&mut self, has_value: bool) -> &mut Column {
        let column = self.columns.next().expect("a row has as many values as columns");
        column.levels.push(i16::from(has_value));
        column
    }

    fn integer(&mut self, value: Option<i64>) {
        match &mut self.next(value.is_some()).values {
            Values::Integers(values) => values.extend(value),
            _ => unreachable!("the column has whole numbers"),
        }
    }

    /// A number; null if it is not finite, as an infinite dilution of precision.
    fn fraction(&mut self, value: Option<f64>) {
        let value = value.filter(|value| value.is_finite());
        match &mut self.next(value.is_some()).values {
            Values::Fractions(values) => values.extend(value),
            _ => unreachable!("the column has fractions"),
        }
    }

    fn text(&mut self, value: Option<&str>) {
        match &mut self.next(value.is_some()).values {
            Values::Texts(values) => values.extend(value.map(ByteArray::from)),
            _ => unreachable!("the column has texts"),
        }
    }

    fn fractions<const N: usize>(&mut self, values: Option<[f64; N]>) {
        for index in 0..N {
            self.fraction(values.map(|values| values[index]));
        }
    }

    /// The columns from `x_m` to `fix_probability`.
    fn estimate(&mut self, estimate: Option<&SolutionEstimate>) {
        let frame = estimate.map(|estimate| LocalFrame::at(estimate.position));
        let local = |covariance: &Matrix3<f64>| {
            let enu = frame.as_ref()?.covariance_to_enu(covariance);
            Some([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].map(|index| enu[index]))
        };
        self.fractions::<3>(estimate.map(|estimate| estimate.position.0.into()));
        self.fractions(estimate.map(|estimate| {
            let at = estimate.position.to_geodetic();
            [at.latitude_rad.to_degrees(), at.longitude_rad.to_degrees(), at.height_m]
        }));
        self.fractions(estimate.and_then(|estimate| local(&estimate.covariance)));
        let velocity = estimate.and_then(|estimate| estimate.velocity.as_ref());
        let enu = velocity.zip(frame.as_ref());
        self.fractions::<3>(
            enu.map(|(velocity, frame)| (frame.rotation * velocity.velocity_m_s).into()),
        );
        self.fractions(velocity.and_then(|velocity| local(&velocity.covariance)));
        self.fraction(estimate.map(|estimate| estimate.clock_m));
        self.fraction(velocity.map(|velocity| velocity.clock_drift_m_s));
        let reception = estimate.map(|estimate| estimate.reception_time.ns_of_week());
        self.fraction(reception.map(|ns| ns as f64 / NS_PER_S));
        self.fractions(estimate.map(|estimate| {
            let dops = &estimate.dops;
            [dops.gdop, dops.pdop, dops.hdop, dops.vdop, dops.tdop]
        }));
        self.integer(estimate.map(|estimate| estimate.satellites_used.len() as i64));
        let satellites = estimate.map(|estimate| {
            let names = estimate.satellites_used.iter().map(ToString::to_string);
            names.collect::<Vec<_>>().join(" ")
        });
        self.text(satellites.as_deref());
        let relative = estimate.and_then(|estimate| estimate.relative.as_ref());
        let enu = relative.zip(frame.as_ref());
        self.fractions::<3>(
            enu.map(|(relative, frame)| (frame.rotation * relative.baseline_m).into()),
        );
        self.fraction(relative.map(|relative| relative.age_s));
        self.integer(relative.map(|relative| relative.ambiguities as i64));
        self.integer(relative.map(|relative| relative.fixed_ambiguities as i64));
        self.fraction(relative.and_then(|relative| relative.ratio));
        self.fraction(relative.and_then(|relative| relative.success_rate));
        self.fraction(relative.and_then(|relative| relative.fix_probability));
    }
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;

    use super::*;
    use crate::formats::encoder::{REFERRED, referred, sample};
    use crate::gnss::{GpsTime, Reason, Solution, Status};

    fn written(mut table: Table, rows: &[(Presented<'_>, Option<Revision>)]) -> Bytes {
        let mut out = Vec::new();
        table.begin(&mut out);
        rows.iter().for_each(|(presented, revision)| table.push(presented, *revision, &mut out));
        table.finish(&mut out);
        out.into()
    }

    #[test]
    fn values_stand_in_their_columns_and_unknown_ones_are_null() {
        let (fixed, none) = (sample(Status::Fixed), Solution::none(GpsTime::EPOCH, Vec::new()));
        let additions = Additions { is_stored: true, ..REFERRED };
        let stored = Some(Revision { seq: 7, revision: 1 });
        let rows = [(referred(&fixed), stored), (referred(&none), stored)];
        let file = written(Table::new(LeapSeconds::table(), additions), &rows);
        let reader = SerializedFileReader::new(file).unwrap();
        let names = reader.metadata().file_metadata().schema().get_fields().iter();
        let names: Vec<_> = names.map(|field| field.name().to_owned()).collect();
        let index = |name: &str| names.iter().position(|known| known == name).unwrap();
        let rows: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        let [fixed, none] = &rows[..] else { panic!("{rows:?}") };
        assert_eq!(
            (fixed.get_long(index("seq")), fixed.get_long(index("revision"))),
            (Ok(7), Ok(1))
        );
        // 2019-04-28T12:58:04Z.
        let micros = fixed.get_timestamp_micros(index("time_utc")).unwrap();
        assert_eq!(micros, 1_556_456_284_000_000);
        assert_eq!(fixed.get_string(index("status")).unwrap(), "FIXED");
        assert!((fixed.get_double(index("latitude_deg")).unwrap() - 47.285_233_166).abs() < 1e-9);
        assert!((fixed.get_double(index("var_n_m2")).unwrap() - 4.0).abs() < 1e-9);
        assert!((fixed.get_double(index("vn_m_s")).unwrap() - 4.0).abs() < 1e-9);
        assert_eq!(fixed.get_string(index("satellite_list")).unwrap(), "E11 G01 G05");
        assert_eq!(fixed.get_double(index("age_s")), Ok(1.5));
        assert_eq!(fixed.get_string(index("frame")).unwrap(), "ETRF2000");
        assert!((fixed.get_double(index("orthometric_height_m")).unwrap() - 453.1).abs() < 1e-6);
        assert_eq!(none.get_string(index("status")).unwrap(), "NONE");
        for name in ["x_m", "age_s", "hpl_m", "frame_epoch_year", "orthometric_height_m"] {
            assert!(none.get_double(index(name)).is_err(), "{name}");
        }
    }

    #[test]
    fn long_tracks_are_written_in_groups() {
        let reasons = vec![Reason::NotConverged];
        let solution = Solution::none(GpsTime::EPOCH, reasons);
        let mut table = Table::new(LeapSeconds::table(), Additions::default());
        let (mut out, mut largest) = (Vec::new(), 0);
        table.begin(&mut out);
        let mut file = std::mem::take(&mut out);
        for _ in 0..2 * GROUP_ROWS + 1 {
            table.push(&Presented::as_computed(&solution), None, &mut out);
            largest = largest.max(out.len());
            file.append(&mut out);
        }
        table.finish(&mut file);
        assert!(0 < largest && largest < file.len() / 2, "{largest} of {}", file.len());
        let reader = SerializedFileReader::new(Bytes::from(file)).unwrap();
        let groups = reader.metadata().row_groups().iter().map(|group| group.num_rows());
        assert_eq!(groups.collect::<Vec<_>>(), [4096, 4096, 1]);
        let first = reader.get_row_iter(None).unwrap().next().unwrap().unwrap();
        assert!(first.to_string().contains("NOT_CONVERGED"), "{first}");
    }
}

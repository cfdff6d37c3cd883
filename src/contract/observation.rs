//! The message `graphfix.v1.Observation`. Written by hand, because an epoch has a hundred of them,
//! each with two texts of two or three letters: as `String` each would be an allocation.

use bytes::Buf;
use prost::bytes::BufMut;
use prost::encoding::{self, DecodeContext, WireType};
use prost::{DecodeError, Message};

use super::short_text::ShortText;

/// One signal of one satellite, with the signs of RINEX: while a satellite approaches, the Doppler
/// is positive and the phase decreases.
#[derive(
    Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema,
)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
pub struct Observation {
    /// The satellite as RINEX 3 writes it, such as G05, R24, E36, C63, J01.
    #[schema(value_type = String)]
    pub satellite: ShortText,
    /// Band and tracking attribute as RINEX 3 writes them, such as 1C, 2I, 7Q.
    #[schema(value_type = String)]
    pub code: ShortText,
    /// Pseudorange (m).
    pub pseudorange_m: Option<f64>,
    /// Carrier phase (cycles).
    pub carrier_phase_cycles: Option<f64>,
    /// Doppler (Hz).
    pub doppler_hz: Option<f64>,
    /// Carrier-to-noise density C/N0 (dB-Hz).
    pub cn0_db_hz: Option<f64>,
    /// A cycle slip was possible since the previous epoch.
    pub loss_of_lock: bool,
    /// The carrier phase may be off by half a cycle.
    pub half_cycle: bool,
}

/// Numbers of the fields.
const SATELLITE: u32 = 1;
const CODE: u32 = 2;
const PSEUDORANGE: u32 = 3;
const CARRIER_PHASE: u32 = 4;
const DOPPLER: u32 = 5;
const CN0: u32 = 6;
const LOSS_OF_LOCK: u32 = 7;
const HALF_CYCLE: u32 = 8;

impl Observation {
    /// The measured values with the numbers of their fields.
    const fn values(&self) -> [(u32, Option<f64>); 4] {
        [
            (PSEUDORANGE, self.pseudorange_m),
            (CARRIER_PHASE, self.carrier_phase_cycles),
            (DOPPLER, self.doppler_hz),
            (CN0, self.cn0_db_hz),
        ]
    }

    const fn flags(&self) -> [(u32, bool); 2] {
        [(LOSS_OF_LOCK, self.loss_of_lock), (HALF_CYCLE, self.half_cycle)]
    }
}

impl Message for Observation {
    fn encode_raw(&self, buffer: &mut impl BufMut) {
        self.satellite.encode(SATELLITE, buffer);
        self.code.encode(CODE, buffer);
        for (tag, value) in self.values() {
            if let Some(value) = value {
                encoding::double::encode(tag, &value, buffer);
            }
        }
        for (tag, flag) in self.flags() {
            if flag {
                encoding::bool::encode(tag, &flag, buffer);
            }
        }
    }

    fn merge_field(
        &mut self,
        tag: u32,
        wire_type: WireType,
        buffer: &mut impl Buf,
        context: DecodeContext,
    ) -> Result<(), DecodeError> {
        let value = |value: &mut Option<f64>, buffer: &mut _| {
            let value = value.get_or_insert(0.0);
            encoding::double::merge(wire_type, value, buffer, context.clone())
        };
        let (name, merged) = match tag {
            SATELLITE => ("satellite", self.satellite.merge(wire_type, buffer, context)),
            CODE => ("code", self.code.merge(wire_type, buffer, context)),
            PSEUDORANGE => ("pseudorange_m", value(&mut self.pseudorange_m, buffer)),
            CARRIER_PHASE => {
                ("carrier_phase_cycles", value(&mut self.carrier_phase_cycles, buffer))
            }
            DOPPLER => ("doppler_hz", value(&mut self.doppler_hz, buffer)),
            CN0 => ("cn0_db_hz", value(&mut self.cn0_db_hz, buffer)),
            LOSS_OF_LOCK => {
                let flag = &mut self.loss_of_lock;
                ("loss_of_lock", encoding::bool::merge(wire_type, flag, buffer, context))
            }
            HALF_CYCLE => {
                let flag = &mut self.half_cycle;
                ("half_cycle", encoding::bool::merge(wire_type, flag, buffer, context))
            }
            _ => return encoding::skip_field(wire_type, tag, buffer, context),
        };
        merged.map_err(|mut error| {
            error.push("Observation", name);
            error
        })
    }

    fn encoded_len(&self) -> usize {
        let values = self.values().into_iter().filter(|(_, value)| value.is_some());
        let values = values.map(|(tag, _)| encoding::key_len(tag) + size_of::<f64>());
        let flags = self.flags().into_iter().filter(|(_, flag)| *flag);
        let flags = flags.map(|(tag, flag)| encoding::bool::encoded_len(tag, &flag));
        let texts = self.satellite.encoded_len(SATELLITE) + self.code.encoded_len(CODE);
        texts + values.chain(flags).sum::<usize>()
    }

    fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The same message with the implementation that `prost` derives.
    #[derive(Clone, PartialEq, Message)]
    struct Derived {
        #[prost(string, tag = "1")]
        satellite: String,
        #[prost(string, tag = "2")]
        code: String,
        #[prost(double, optional, tag = "3")]
        pseudorange_m: Option<f64>,
        #[prost(double, optional, tag = "4")]
        carrier_phase_cycles: Option<f64>,
        #[prost(double, optional, tag = "5")]
        doppler_hz: Option<f64>,
        #[prost(double, optional, tag = "6")]
        cn0_db_hz: Option<f64>,
        #[prost(bool, tag = "7")]
        loss_of_lock: bool,
        #[prost(bool, tag = "8")]
        half_cycle: bool,
    }

    impl From<&Observation> for Derived {
        fn from(of: &Observation) -> Self {
            Self {
                satellite: of.satellite.to_string(),
                code: of.code.to_string(),
                pseudorange_m: of.pseudorange_m,
                carrier_phase_cycles: of.carrier_phase_cycles,
                doppler_hz: of.doppler_hz,
                cn0_db_hz: of.cn0_db_hz,
                loss_of_lock: of.loss_of_lock,
                half_cycle: of.half_cycle,
            }
        }
    }

    prop_compose! {
        fn observation()(
            texts: (String, String),
            satellite in "[GREC][0-9]{2}|.{0,9}",
            values: [Option<f64>; 4],
            flags: (bool, bool),
            has_long: bool,
        ) -> Observation {
            let satellite = if has_long { texts.0.as_str() } else { satellite.as_str() };
            let [pseudorange_m, carrier_phase_cycles, doppler_hz, cn0_db_hz] = values;
            Observation {
                satellite: satellite.into(),
                code: texts.1.as_str().into(),
                pseudorange_m,
                carrier_phase_cycles,
                doppler_hz,
                cn0_db_hz,
                loss_of_lock: flags.0,
                half_cycle: flags.1,
            }
        }
    }

    proptest! {
        #[test]
        fn it_is_the_message_of_the_schema(observation in observation()) {
            let bytes = observation.encode_to_vec();
            prop_assert_eq!(bytes.len(), observation.encoded_len());
            let derived = Derived::from(&observation);
            prop_assert_eq!(&derived.encode_to_vec(), &bytes);
            let read = Observation::decode(&*bytes).unwrap();
            prop_assert_eq!(format!("{read:?}"), format!("{observation:?}"));
            let json = serde_json::to_value(&observation).unwrap();
            prop_assert_eq!(&json["satellite"], &derived.satellite);
        }

        /// Damaged bytes give the same value or the same error as with the derived message.
        #[test]
        fn damaged_bytes_are_read_alike(
            observation in observation(),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
            end: prop::sample::Index,
        ) {
            let mut bytes = observation.encode_to_vec();
            bytes.push(0);
            for (index, byte) in changes {
                let index = index.index(bytes.len());
                bytes[index] = byte;
            }
            bytes.truncate(end.index(bytes.len() + 1));
            let read = Observation::decode(&*bytes).map(|read| format!("{:?}", Derived::from(&read)));
            let derived = Derived::decode(&*bytes).map(|derived| format!("{derived:?}"));
            let plain = |error: DecodeError| error.to_string().replace("Derived", "Observation");
            prop_assert_eq!(read.map_err(plain), derived.map_err(plain));
        }
    }
}

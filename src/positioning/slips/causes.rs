//! Why an arc may have ended, by name.

/// What a detector found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum SlipCause {
    /// The receiver lost power since the previous epoch.
    PowerFailure,
    /// The receiver says that it lost lock. Formats that carry a lock time instead (RTCM MSM
    /// DF402, UBX RXM-RAWX) enter here: their reader sets [`Observation::loss_of_lock`] where the
    /// lock time fell.
    ///
    /// [`Observation::loss_of_lock`]: crate::gnss::Observation::loss_of_lock
    LossOfLock,
    /// The half-cycle flag changed: half a cycle may have been added.
    HalfCycle,
    /// The signal was away for too long for anything to tell what happened meanwhile.
    Gap,
    /// The difference of two carrier phases of the satellite jumped.
    GeometryFree,
    /// The wide-lane ambiguity jumped.
    MelbourneWuebbena,
    /// The phase changed by something else than the Doppler says.
    Doppler,
    /// The phase changed by something else than the other satellites say.
    TimeDifference,
}

impl SlipCause {
    /// Every cause, in the order in which they are reported.
    pub const ALL: [Self; 8] = [
        Self::PowerFailure,
        Self::LossOfLock,
        Self::HalfCycle,
        Self::Gap,
        Self::GeometryFree,
        Self::MelbourneWuebbena,
        Self::Doppler,
        Self::TimeDifference,
    ];

    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::PowerFailure => "power-failure",
            Self::LossOfLock => "loss-of-lock",
            Self::HalfCycle => "half-cycle",
            Self::Gap => "gap",
            Self::GeometryFree => "geometry-free",
            Self::MelbourneWuebbena => "melbourne-wuebbena",
            Self::Doppler => "doppler",
            Self::TimeDifference => "time-difference",
        }
    }
}

/// A set of causes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlipCauses(u8);

impl SlipCauses {
    /// Adds a cause.
    pub(super) fn insert(&mut self, cause: SlipCause) {
        self.0 |= 1 << cause as u8;
    }

    /// Whether the cause is among them.
    pub const fn contains(self, cause: SlipCause) -> bool {
        self.0 & (1 << cause as u8) != 0
    }

    /// Whether there is none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The causes, in the order of [`SlipCause::ALL`].
    pub fn iter(self) -> impl Iterator<Item = SlipCause> {
        SlipCause::ALL.into_iter().filter(move |cause| self.contains(*cause))
    }
}

//! Options of what is given out: the frame of positions, and their heights above the geoid;
//! `output_table` names and explains them.
//!
//! No estimator reads them, and they are not part of the hash of a configuration: what is computed
//! and stored is the same with all of them.

use std::sync::Arc;

use crate::gnss::{CoordinateFrame, Geoid, Presentation};

use super::choices::OutputFrame;

/// Options of what is given out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputOptions {
    /// The frame of positions.
    pub frame: OutputFrame,
    /// The frame of a base that states none.
    pub base_frame: Option<CoordinateFrame>,
    /// Whether heights above the geoid are given, too.
    pub geoid: bool,
}

impl OutputOptions {
    /// Positions as they are computed, without heights above the geoid.
    pub const fn as_computed() -> Self {
        Self { frame: OutputFrame::Native, base_frame: None, geoid: false }
    }

    /// A line for the head of a file of positions in another frame than the computed one.
    pub fn comment(&self) -> Option<String> {
        let frame = (self.frame != OutputFrame::Native).then(|| self.frame.name())?;
        Some(format!("frame     : {frame}"))
    }

    /// How solutions are presented, with the geoid of the service or command.
    pub fn presentation(&self, geoid: Option<&Arc<Geoid>>) -> Presentation {
        Presentation {
            etrs89: self.frame == OutputFrame::Etrs89,
            base_frame: self.base_frame,
            geoid: geoid.filter(|_| self.geoid).cloned(),
        }
    }
}

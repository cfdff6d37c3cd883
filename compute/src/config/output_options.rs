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

    /// A line for the head of a file of computed positions: their frame. `is_relative`: to a base,
    /// in whose frame they are unless another one is asked for.
    pub fn frame_comment(&self, is_relative: bool) -> String {
        let frame = match (self.frame, self.base_frame) {
            (OutputFrame::Native, _) if !is_relative => "WGS84".to_owned(),
            (OutputFrame::Native, Some(stated)) => format!("{stated}, which the base states"),
            (OutputFrame::Native, None) => "that of the base, which is not stated here".to_owned(),
            (frame, _) => frame.name().to_owned(),
        };
        format!("frame     : {frame}")
    }

    /// A line for the head of a file of positions in another frame than the computed one.
    pub fn comment(&self) -> Option<String> {
        let frame = (self.frame != OutputFrame::Native).then(|| self.frame.name())?;
        Some(format!("frame     : {frame}"))
    }

    /// How solutions are presented, with the geoid of the service or command.
    pub fn presentation(&self, geoid: Option<&Arc<Geoid>>) -> Presentation {
        let etrs89 = self.frame == OutputFrame::Etrs89;
        Presentation {
            etrs89,
            base_frame: self.base_frame,
            names_frames: etrs89 || self.base_frame.is_some(),
            geoid: geoid.filter(|_| self.geoid).cloned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_of_a_file_says_the_frame_of_its_positions() {
        let native = OutputOptions::as_computed();
        let base_frame = CoordinateFrame::parse("ITRF2014@2010.0");
        let stated = OutputOptions { base_frame, ..native };
        let etrs89 = OutputOptions { frame: OutputFrame::Etrs89, ..stated };
        for (options, is_relative, expected) in [
            (native, false, "frame     : WGS84"),
            (stated, false, "frame     : WGS84"),
            (native, true, "frame     : that of the base, which is not stated here"),
            (stated, true, "frame     : ITRF2014@2010.0, which the base states"),
            (etrs89, true, "frame     : ETRS89"),
        ] {
            assert_eq!(options.frame_comment(is_relative), expected);
            let names_frames = options.presentation(None).names_frames;
            assert_eq!(names_frames, options != native, "{expected}");
        }
    }
}

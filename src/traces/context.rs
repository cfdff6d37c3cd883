//! The identity of a span, and how a caller sends its own: W3C Trace Context, level 1.

/// The identity of a span.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TraceContext {
    /// The trace; not zero.
    pub(crate) trace_id: u128,
    /// The span within the trace; not zero.
    pub(crate) span_id: u64,
    /// Whether the caller traces this request (the flag `sampled`).
    pub(crate) is_traced: bool,
}

impl TraceContext {
    /// A new trace.
    pub(crate) fn random() -> Self {
        let trace_id = uuid::Uuid::new_v4().as_u128();
        Self { trace_id, span_id: Self::random_span(), is_traced: true }
    }

    /// Another span of the same trace.
    pub(super) fn child(self) -> Self {
        Self { span_id: Self::random_span(), is_traced: true, ..self }
    }

    fn random_span() -> u64 {
        // A version-4 id has 64 random bits less two in its lower half; its upper two are "10".
        uuid::Uuid::new_v4().as_u64_pair().1
    }

    /// The caller's span in a header `traceparent`; `None` if the header is invalid, which the
    /// standard says to ignore. Later versions may have further fields.
    pub(crate) fn parse(header: &str) -> Option<Self> {
        let mut fields = header.trim().split('-');
        let mut field = |digits: usize| {
            let field = fields.next().filter(|field| field.len() == digits)?;
            let is_hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
            field.bytes().all(is_hex).then_some(field)
        };
        let (version, trace, span, flags) = (field(2)?, field(32)?, field(16)?, field(2)?);
        if version == "ff" || (version == "00" && fields.next().is_some()) {
            return None;
        }
        let trace_id = u128::from_str_radix(trace, 16).ok().filter(|id| *id != 0)?;
        let span_id = u64::from_str_radix(span, 16).ok().filter(|id| *id != 0)?;
        let flags = u8::from_str_radix(flags, 16).ok()?;
        Some(Self { trace_id, span_id, is_traced: flags & 1 == 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";

    #[test]
    fn the_example_of_the_standard_is_read() {
        // W3C Trace Context, section 3.2.2.5.
        let read = TraceContext::parse(&format!("00-{TRACE}-00f067aa0ba902b7-01")).unwrap();
        assert_eq!(read.trace_id, 0x4bf9_2f35_77b3_4da6_a3ce_929d_0e0e_4736);
        assert_eq!(read.span_id, 0x00f0_67aa_0ba9_02b7);
        assert!(read.is_traced);
        let not = TraceContext::parse(&format!("00-{TRACE}-00f067aa0ba902b7-00")).unwrap();
        assert!(!not.is_traced);
        let later = format!("cc-{TRACE}-00f067aa0ba902b7-01-what-the-future-will-be-like");
        assert_eq!(TraceContext::parse(&later), Some(read));
    }

    #[test]
    fn what_is_not_valid_is_ignored() {
        for wrong in [
            String::new(),
            "00".to_owned(),
            format!("ff-{TRACE}-00f067aa0ba902b7-01"),
            format!("00-{TRACE}-00f067aa0ba902b7-01-more"),
            format!("00-{}-00f067aa0ba902b7-01", "0".repeat(32)),
            format!("00-{TRACE}-0000000000000000-01"),
            format!("00-{}-00f067aa0ba902b7-01", TRACE.to_uppercase()),
            format!("00-{TRACE}-00f067aa0ba902b7-+1"),
            format!("00-{TRACE}é-00f067aa0ba902b7-01"),
        ] {
            assert_eq!(TraceContext::parse(&wrong), None, "{wrong:?}");
        }
    }
}

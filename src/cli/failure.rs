//! Why a command ends without having done its work.

use std::fmt;

use crate::config::ConfigError;
use crate::refusal::Code;

/// Why a command failed: a stable code, what is wrong and what to do, in one line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Failure {
    code: Code,
    message: String,
    remedy: String,
}

impl Failure {
    /// A failure with a code, what is wrong, and the remedy in terms of the command's arguments.
    pub(crate) fn new(code: Code, message: impl fmt::Display, remedy: impl fmt::Display) -> Self {
        Self { code, message: message.to_string(), remedy: remedy.to_string() }
    }

    /// A failure with the standard remedy of its code, put in terms of a command.
    pub(crate) fn of(code: Code, message: impl fmt::Display) -> Self {
        let remedy = match code {
            // The standard remedy is to send the request again. A command has no request.
            Code::DatabaseFailed => "check the URL, and that the database exists and answers",
            code => code.remedy(),
        };
        Self::new(code, message, remedy)
    }

    /// The stable code.
    #[cfg(test)]
    pub(crate) const fn code(&self) -> Code {
        self.code
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = format!("{} ({})", self.message, self.remedy).replace(['\n', '\r'], " ");
        write!(f, "error[{}]: {line}", self.code)
    }
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        Self::new(error.code(), error, "see graphfix config")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_is_one_line_with_code_and_remedy() {
        let failure = Failure::new(Code::FileNotReadable, "no file a\nb", "name another");
        assert_eq!(failure.to_string(), "error[FILE_NOT_READABLE]: no file a b (name another)");
    }

    #[test]
    fn a_command_whose_database_fails_is_not_told_to_send_a_request() {
        let line =
            Failure::of(Code::DatabaseFailed, "database \"nodb\" does not exist").to_string();
        assert!(
            line.ends_with("(check the URL, and that the database exists and answers)"),
            "{line}"
        );
        assert!(!line.contains("request"), "{line}");
    }
}

//! Requests that get no answer but a reason: a status, and a sentence in JSON.

use brickmarch::{Error, ErrorKind};
use hyper::StatusCode;

/// Why a request is refused.
#[derive(Debug)]
pub(super) struct Refusal {
    pub(super) status: StatusCode,
    pub(super) message: String,
}

impl Refusal {
    pub(super) fn new(status: StatusCode, message: impl Into<String>) -> Refusal {
        Refusal {
            status,
            message: message.into(),
        }
    }

    /// 400.
    pub(super) fn bad(message: impl Into<String>) -> Refusal {
        Refusal::new(StatusCode::BAD_REQUEST, message)
    }

    /// 404.
    pub(super) fn missing(message: impl Into<String>) -> Refusal {
        Refusal::new(StatusCode::NOT_FOUND, message)
    }

    /// 413.
    pub(super) fn large(message: impl Into<String>) -> Refusal {
        Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, message)
    }

    /// 503: the same request may succeed in a moment.
    pub(super) fn busy() -> Refusal {
        Refusal::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "the memory budget is in use by other requests: try again",
        )
    }

    /// The object that is sent.
    pub(super) fn json(&self) -> serde_json::Value {
        serde_json::json!({ "error": self.message, "status": self.status.as_u16() })
    }
}

impl From<Error> for Refusal {
    fn from(error: Error) -> Refusal {
        let status = match error.kind() {
            ErrorKind::BadInput | ErrorKind::Unsupported => StatusCode::BAD_REQUEST,
            ErrorKind::EmptySurface => StatusCode::UNPROCESSABLE_ENTITY,
            ErrorKind::LimitExceeded => StatusCode::PAYLOAD_TOO_LARGE,
            ErrorKind::BudgetExceeded | ErrorKind::Cancelled => StatusCode::SERVICE_UNAVAILABLE,
            kind => {
                // The message names a file of this machine, which is nobody's business elsewhere.
                crate::job::message(&format!("brickmarch: {error}"));
                return Refusal::new(
                    StatusCode::INTERNAL_SERVER_ERROR,
                    format!("the volume cannot be read ({kind:?}); the server has said more"),
                );
            }
        };
        Refusal::new(status, error.to_string())
    }
}

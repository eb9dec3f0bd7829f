//! May this request open the stream? Its head must come in time, be short, and come from an allowed web page.

use std::io::{ErrorKind, Read};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Time for the whole head of the request.
const HEAD_TIME_MAX: Duration = Duration::from_secs(3);
/// Largest head, bytes.
const HEAD_BYTES_MAX: usize = 8 * 1024;
/// End of a head.
const HEAD_END: &[u8] = b"\r\n\r\n";

/// Why a request is rejected.
#[derive(Debug, thiserror::Error)]
pub(super) enum RequestError {
    #[error("no complete request within {} s", HEAD_TIME_MAX.as_secs())]
    TooSlow,
    #[error("a request head of more than {HEAD_BYTES_MAX} bytes")]
    TooLong,
    #[error("a web page of {0:?}, which [stream] origins does not list")]
    Origin(String),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// Reads the head of a request and what was sent after it: all bytes, and the length of the head.
pub(super) fn read_head(client: &mut TcpStream) -> Result<(Vec<u8>, usize), RequestError> {
    let deadline = Instant::now() + HEAD_TIME_MAX;
    let mut received = Vec::new();
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(RequestError::TooSlow);
        }
        client.set_read_timeout(Some(left))?;
        let mut bytes = [0; 1024];
        match client.read(&mut bytes) {
            Ok(0) => return Err(std::io::Error::from(ErrorKind::UnexpectedEof).into()),
            Ok(length) => received.extend_from_slice(&bytes[..length]),
            Err(error) if is_timeout(&error) => return Err(RequestError::TooSlow),
            Err(error) => return Err(error.into()),
        }
        if let Some(head_bytes) = head_length(&received)? {
            return Ok((received, head_bytes));
        }
    }
}

/// Length of the head in what was received so far. None if its end has not come yet.
pub(super) fn head_length(received: &[u8]) -> Result<Option<usize>, RequestError> {
    let end = received
        .windows(HEAD_END.len())
        .position(|window| window == HEAD_END);
    match end {
        Some(at) => Ok(Some(at + HEAD_END.len())),
        None if received.len() > HEAD_BYTES_MAX => Err(RequestError::TooLong),
        None => Ok(None),
    }
}

/// True if a read or write ended with its timeout.
pub(super) fn is_timeout(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

/// Rejects a request of a web page that is not in `origins`. Programs that are no browser send no origin.
///
/// An entry without a port stands for every port. "*" stands for every page.
pub(super) fn check_origin(head: &[u8], origins: &[String]) -> Result<(), RequestError> {
    let head = String::from_utf8_lossy(head);
    let mut lines = head.lines().skip(1).filter_map(|line| line.split_once(':'));
    let origin = lines.find_map(|(name, value)| {
        name.trim()
            .eq_ignore_ascii_case("origin")
            .then(|| value.trim().to_owned())
    });
    let Some(origin) = origin else {
        return Ok(());
    };
    let is_listed = origins.iter().any(|entry| {
        let rest = origin.strip_prefix(entry.as_str());
        entry == "*"
            || rest.is_some_and(|rest| {
                rest.is_empty()
                    || rest.strip_prefix(':').is_some_and(|port| {
                        !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit())
                    })
            })
    });
    if is_listed {
        Ok(())
    } else {
        Err(RequestError::Origin(origin))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_listed_web_pages_are_accepted() {
        let origins = ["https://app.foxglove.dev", "http://localhost"].map(str::to_owned);
        let accepts = |line: &str| {
            let head = format!("GET / HTTP/1.1\r\nHost: robot\r\n{line}\r\n\r\n");
            check_origin(head.as_bytes(), &origins).is_ok()
        };
        assert!(accepts("Upgrade: websocket"));
        assert!(accepts("Origin: https://app.foxglove.dev"));
        assert!(accepts("oRiGiN:http://localhost:8080"));
        assert!(!accepts("Origin: http://localhost.evil.example"));
        assert!(!accepts("Origin: http://localhost:8080.evil.example"));
        assert!(!accepts("Origin: http://localhost:"));
        assert!(!accepts("Origin: https://evil.example"));
        assert!(!accepts("Origin: null"));
        let any = ["*".to_owned()];
        assert!(check_origin(b"GET / HTTP/1.1\r\nOrigin: x\r\n\r\n", &any).is_ok());
    }
}

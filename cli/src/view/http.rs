//! As much of HTTP/1.1 as a page on this machine needs: one request of a connection, without a body, and its answer.
//!
//! Whoever can reach the server can send anything, and slowly: what is held of a connection is bounded in bytes and in time, and a
//! connection is over with its answer.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

/// Most bytes of a request up to its empty line; those of browsers take below 1 KiB.
const MOST_HEAD: usize = 16 << 10;

/// How long a request may take to arrive, and its answer to be fetched: both stay on this machine.
const REQUEST: Duration = Duration::from_secs(3);
const ANSWER: Duration = Duration::from_secs(30);

/// Bytes that are written at a time, so that time is looked at in between.
const PIECE: usize = 1 << 16;

/// Most bytes of a request that are read after the answer is ready. Closing a connection with unread bytes would
/// discard the answer.
const MOST_LEFT: usize = 1 << 18;
const LEFT: Duration = Duration::from_millis(500);

/// Head of a request.
#[derive(Debug, PartialEq, Eq)]
pub struct Request {
    pub method: String,
    /// With what follows a question mark.
    pub target: String,
    /// All that the host is named as.
    pub hosts: Vec<String>,
}

/// The end of a connection's time for something.
struct Deadline(Instant);

impl Deadline {
    fn new(time: Duration) -> Self {
        Deadline(Instant::now() + time)
    }

    /// Returns the time left, or an error of kind `TimedOut`.
    fn left(&self) -> io::Result<Duration> {
        let left = self.0.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(io::ErrorKind::TimedOut.into()) } else { Ok(left) }
    }
}

/// Reads the request; the status that refuses it where it is none.
pub fn request(stream: &mut TcpStream) -> io::Result<Result<Request, u16>> {
    let deadline = Deadline::new(REQUEST);
    let mut head = Vec::new();
    loop {
        stream.set_read_timeout(Some(deadline.left()?))?;
        let mut piece = [0; 2048];
        let count = stream.read(&mut piece)?;
        if count == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        head.extend(&piece[..count]);
        if let Some(end) = head.windows(4).position(|w| w == b"\r\n\r\n") {
            return Ok(parse(&head[..end]).ok_or(400));
        }
        if head.len() > MOST_HEAD {
            return Ok(Err(431));
        }
    }
}

/// The request of the lines before the empty one.
fn parse(head: &[u8]) -> Option<Request> {
    let mut lines = std::str::from_utf8(head).ok()?.split("\r\n");
    let mut words = lines.next()?.split(' ');
    let (method, target, version) = (words.next()?, words.next()?, words.next()?);
    if words.next().is_some() || !["HTTP/1.1", "HTTP/1.0"].contains(&version) {
        return None;
    }
    let mut hosts = Vec::new();
    for line in lines {
        let (name, value) = line.split_once(':')?;
        if name.eq_ignore_ascii_case("host") {
            hosts.push(value.trim().to_owned());
        }
    }
    Some(Request { method: method.into(), target: target.into(), hosts })
}

/// Answers with `headers` and `body`, and ends the connection.
pub fn answer(mut stream: &TcpStream, status: u16, headers: &[(&str, &str)], body: &[u8]) -> io::Result<()> {
    let mut head = format!("HTTP/1.1 {status} {}\r\n", reason(status));
    for (name, value) in headers {
        head += &format!("{name}: {value}\r\n");
    }
    head += &format!("Content-Length: {}\r\nConnection: close\r\n\r\n", body.len());
    let deadline = Deadline::new(ANSWER);
    for mut piece in [head.as_bytes()].into_iter().chain(body.chunks(PIECE)) {
        while !piece.is_empty() {
            stream.set_write_timeout(Some(deadline.left()?))?;
            let count = stream.write(piece)?;
            if count == 0 {
                return Err(io::ErrorKind::WriteZero.into());
            }
            piece = &piece[count..];
        }
    }
    stream.shutdown(Shutdown::Write)?;
    let (deadline, mut left, mut piece) = (Deadline::new(LEFT), MOST_LEFT, [0; 2048]);
    while left > 0 {
        stream.set_read_timeout(Some(deadline.left()?))?;
        match stream.read(&mut piece)? {
            0 => break,
            count => left = left.saturating_sub(count),
        }
    }
    Ok(())
}

/// The words of a status.
fn reason(status: u16) -> &'static str {
    match status {
        200 => "OK",
        302 => "Found",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        431 => "Request Header Fields Too Large",
        _ => "Error",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read() {
        let found = parse(b"GET /a?b HTTP/1.1\r\nhost:  here:1 \r\nAccept: */*\r\nHost: there").unwrap();
        assert_eq!(found.hosts, ["here:1", "there"]);
        assert_eq!((found.method.as_str(), found.target.as_str()), ("GET", "/a?b"));
        for broken in ["", "GET", "GET /", "GET / HTTP/2", "GET /  HTTP/1.1", "GET / HTTP/1.1\r\nno colon"] {
            assert_eq!(parse(broken.as_bytes()), None, "{broken}");
        }
    }
}

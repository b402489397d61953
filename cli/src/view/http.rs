//! The part of HTTP/1.1 that a page on this machine needs: one request per connection, without a body, and its
//! response.
//!
//! Clients may send anything, and slowly, so the bytes and the time of a connection are bounded, and it is closed after
//! the response.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

/// Largest head of a request in bytes; those of browsers take less than 1 KiB.
const MOST_HEAD: usize = 16 << 10;

/// Time limit for a request to arrive, and for its response to be fetched, both on this machine.
const REQUEST: Duration = Duration::from_secs(3);
const ANSWER: Duration = Duration::from_secs(30);

/// Bytes that are written at a time, with a check of the time limit in between.
const PIECE: usize = 1 << 16;

/// Largest number of bytes of a request that are read after the response. Closing a connection with unread bytes would
/// discard the response.
const MOST_LEFT: usize = 1 << 18;
const LEFT: Duration = Duration::from_millis(500);

/// The head of a request.
#[derive(Debug, PartialEq, Eq)]
pub struct Request {
    pub method: String,
    /// Path and query.
    pub target: String,
    /// All `Host` headers.
    pub hosts: Vec<String>,
}

/// A deadline of a connection.
struct Deadline(Instant);

impl Deadline {
    fn new(time: Duration) -> Self {
        Deadline(Instant::now() + time)
    }

    /// Returns the remaining time, or an error of kind `TimedOut`.
    fn left(&self) -> io::Result<Duration> {
        let left = self.0.saturating_duration_since(Instant::now());
        if left.is_zero() { Err(io::ErrorKind::TimedOut.into()) } else { Ok(left) }
    }
}

/// Reads a request, or returns the status that refuses it.
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

/// Parses the lines of the head.
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

/// The body of a response. Only its length is sent for `HEAD`.
#[derive(Debug, Clone, Copy)]
pub struct Body<'a> {
    pub bytes: &'a [u8],
    pub is_sent: bool,
}

/// Sends a response with `headers` and `body`, and closes the connection.
pub fn answer(mut stream: &TcpStream, status: u16, headers: &[(&str, &str)], body: Body) -> io::Result<()> {
    let mut head = format!("HTTP/1.1 {status} {}\r\n", reason(status));
    for (name, value) in headers {
        head += &format!("{name}: {value}\r\n");
    }
    head += &format!("Content-Length: {}\r\nConnection: close\r\n\r\n", body.bytes.len());
    let body = if body.is_sent { body.bytes } else { &[] };
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

/// Returns the reason phrase of a status.
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

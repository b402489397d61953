//! Serves the viewer and its files to this machine only, until the program is ended or nothing is requested any more.

use std::io;
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use super::Shown;
use super::http::{self, Body, Request};
use super::package::{self, PAGE};
use crate::failure::{Failure, Kind};
use crate::sink::say;

/// Number of connections that are served at a time, each by a thread; a browser opens up to six. Further connections
/// wait. The time limits of `http` apply to each, so slow or idle ones do not block the others.
const THREADS: usize = 32;

/// Pause after a failed `accept`, which happens if there are too many connections.
const PAUSE: Duration = Duration::from_millis(50);

/// Content security policy of the page: it may run its own scripts and WebAssembly, and send requests to this server.
/// The worker that encodes is made of blobs, so that no request is sent when a picture is there.
const POLICY: &str = "default-src 'none'; script-src 'self' blob: 'wasm-unsafe-eval'; worker-src 'self' blob:; connect-src 'self'; \
                      style-src 'unsafe-inline'; img-src 'self' blob: data:; frame-ancestors 'none'; base-uri 'none'";

/// Whether the page is opened in a browser.
pub enum Opens {
    Browser,
    Nothing,
}

/// Everything that is served.
struct Served {
    file: Option<(String, Vec<u8>)>,
    original: Option<(String, Vec<u8>)>,
    /// Host names that legitimate requests use. A script of another page that reaches this address through its own name
    /// (DNS rebinding) sends that name instead, and is refused.
    hosts: [String; 2],
    /// The address of the page, with the files that it shows.
    start: String,
}

/// Serves until the program is ended, or until nothing was requested for the time `idle`, if that is given.
pub fn run(file: Option<Shown>, original: Option<Shown>, opens: Opens, idle: Option<Duration>) -> Result<(), Failure> {
    let failed = |e: io::Error| Failure { kind: Kind::Other, message: format!("server: {e}") };
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(failed)?;
    let port = listener.local_addr().map_err(failed)?.port();
    let place = |folder: &str, shown: Shown| (format!("/{folder}/{}", shown.name), shown.bytes);
    let (file, original) = (file.map(|f| place("file", f)), original.map(|o| place("original", o)));
    let mut start = "/viewer/".to_owned();
    for (name, shown) in [("?file=", &file), ("&original=", &original)] {
        if let Some((path, _)) = shown {
            start += &format!("{name}{path}");
        }
    }
    let hosts = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    let url = format!("http://{}{start}", hosts[0]);
    let served = Served { file, original, hosts, start };
    say(&format!("{url}\n"))?;
    match idle {
        None => eprintln!("ssplat: serving the page until Ctrl-C"),
        Some(idle) => eprintln!("ssplat: serving the page until {} seconds pass without a request", idle.as_secs()),
    }
    let last = Mutex::new(Instant::now());
    if let Opens::Browser = opens {
        // Opening a browser may take a while.
        thread::spawn(move || {
            if let Err(error) = open::that_detached(&url) {
                eprintln!("ssplat: could not open a browser: {error}");
            }
        });
    }
    thread::scope(|scope| {
        if let Some(idle) = idle {
            let last = &last;
            scope.spawn(move || {
                loop {
                    let since = last.lock().unwrap_or_else(|e| e.into_inner()).elapsed();
                    match idle.checked_sub(since) {
                        Some(left) if !left.is_zero() => thread::sleep(left),
                        // The other threads wait for requests, which do not come. Nothing is left to clean up.
                        _ => std::process::exit(0),
                    }
                }
            });
        }
        for _ in 0..THREADS {
            scope.spawn(|| {
                loop {
                    match listener.accept() {
                        // A client that closes the connection early does not need the response.
                        Ok((mut stream, _)) => {
                            *last.lock().unwrap_or_else(|e| e.into_inner()) = Instant::now();
                            drop(served.answer(&mut stream));
                        }
                        Err(_) => thread::sleep(PAUSE),
                    }
                }
            });
        }
    });
    Ok(())
}

impl Served {
    fn answer(&self, stream: &mut TcpStream) -> io::Result<()> {
        let request = http::request(stream)?;
        let is_sent = !matches!(&request, Ok(request) if request.method == "HEAD");
        let found = request.and_then(|request| self.found(&request));
        let body = |bytes| Body { bytes, is_sent };
        match found {
            Ok((kind, bytes)) => {
                // The encoder is kept compressed, which every browser that runs WebAssembly takes.
                let is_compressed = kind == WASM && bytes.starts_with(&[0x1f, 0x8b]);
                let encoding = is_compressed.then_some(("Content-Encoding", "gzip"));
                let more: Vec<_> = [("Content-Type", kind)].into_iter().chain(encoding).collect();
                http::answer(stream, 200, &headers(&more), body(bytes))
            }
            Err(302) => http::answer(stream, 302, &headers(&[("Location", &self.start)]), body(&[])),
            Err(405) => http::answer(stream, 405, &headers(&[("Allow", "GET, HEAD")]), body(&[])),
            Err(status) => http::answer(stream, status, &HEADERS, body(&[])),
        }
    }

    /// Returns the media type and the bytes of the requested resource, or the status of an error.
    fn found(&self, request: &Request) -> Result<(&'static str, &[u8]), u16> {
        match &request.hosts[..] {
            [host] if self.hosts.iter().any(|known| host.eq_ignore_ascii_case(known)) => {}
            _ => return Err(403),
        }
        // No resource accepts a body.
        if !["GET", "HEAD"].contains(&request.method.as_str()) {
            return Err(405);
        }
        // Paths are looked up in a list, never in the file system.
        let path = request.target.split('?').next().unwrap_or_default();
        match path {
            "/" => return Err(302),
            "/viewer/" => return package::file(PAGE).map(|page| (kind(PAGE), page)).ok_or(404),
            _ => {}
        }
        for (known, bytes) in self.file.iter().chain(&self.original) {
            if path == known {
                return Ok(("application/octet-stream", bytes));
            }
        }
        let name = path.strip_prefix('/').unwrap_or_default();
        package::file(name).map(|bytes| (kind(name), bytes)).ok_or(404)
    }
}

/// The media type of WebAssembly.
const WASM: &str = "application/wasm";

/// Returns the media type of a file of the viewer.
fn kind(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("wasm") => WASM,
        _ => "application/octet-stream",
    }
}

/// Headers of all responses.
const HEADERS: [(&str, &str); 5] = [
    ("Cache-Control", "no-store"),
    ("Content-Security-Policy", POLICY),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    ("Referrer-Policy", "no-referrer"),
    ("X-Content-Type-Options", "nosniff"),
];

/// Returns the headers of all responses, and `more`.
fn headers<'a>(more: &[(&'a str, &'a str)]) -> Vec<(&'a str, &'a str)> {
    HEADERS.iter().chain(more).copied().collect()
}

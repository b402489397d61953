//! Serves the viewer and what it shows to this machine alone, until the program is ended.

use std::net::Ipv4Addr;
use std::thread;

use tiny_http::{Header, Method, Request, Response, Server};

use super::Shown;
use super::package::{self, PAGE};
use crate::failure::{Failure, Kind};
use crate::sink::say;

/// Requests that are answered at once; a browser asks for several.
const THREADS: usize = 4;

/// What the page may do: run its own scripts and WebAssembly, and ask this server.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; connect-src 'self'; \
                      style-src 'unsafe-inline'; img-src 'self' blob: data:; frame-ancestors 'none'; base-uri 'none'";

/// Whether a browser is opened at the page.
pub enum Opens {
    Browser,
    Nothing,
}

/// Everything that can be asked for.
struct Served {
    file: (String, Vec<u8>),
    original: Option<(String, Vec<u8>)>,
    /// What requests for this server name as their host. Another page's script that reaches this address by a name of its own
    /// (DNS rebinding) names that.
    hosts: [String; 2],
    /// The page, with what it shows.
    start: String,
}

/// Serves until the program is ended.
pub fn run(file: Shown, original: Option<Shown>, opens: Opens) -> Result<(), Failure> {
    let failed = |message: String| Failure { kind: Kind::Other, message };
    let server = Server::http((Ipv4Addr::LOCALHOST, 0)).map_err(|e| failed(format!("server: {e}")))?;
    let port = server.server_addr().to_ip().map(|a| a.port()).ok_or_else(|| failed("server: no port".into()))?;
    let place = |folder: &str, shown: Shown| (format!("/{folder}/{}", shown.name), shown.bytes);
    let (file, original) = (place("file", file), original.map(|o| place("original", o)));
    let mut start = format!("/viewer/?file={}", file.0);
    if let Some((path, _)) = &original {
        start += &format!("&original={path}");
    }
    let hosts = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    let url = format!("http://{}{start}", hosts[0]);
    let served = Served { file, original, hosts, start };
    say(&format!("{url}\n"))?;
    eprintln!("ssplat: the page is there until this program ends, by Ctrl-C");
    if let Opens::Browser = opens {
        // Finding one may take a while.
        thread::spawn(move || {
            if let Err(error) = open::that_detached(&url) {
                eprintln!("ssplat: no browser was opened: {error}");
            }
        });
    }
    thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                while let Ok(request) = server.recv() {
                    served.answer(request);
                }
            });
        }
    });
    Ok(())
}

impl Served {
    fn answer(&self, request: Request) {
        // Whoever does not wait for the answer does not need it.
        let _ = match self.found(&request) {
            Ok((kind, bytes)) => {
                let (head, length) = (headers(&[("Content-Type", kind)]), bytes.len());
                let response = Response::new(200.into(), head, bytes, Some(length), None);
                // Bytes that are all there have a length.
                request.respond(response.with_chunked_threshold(usize::MAX))
            }
            Err(302) => request.respond(plain(302, &[("Location", &self.start)])),
            Err(405) => request.respond(plain(405, &[("Allow", "GET")])),
            Err(status) => request.respond(plain(status, &[])),
        };
    }

    /// The media type and the bytes of what is asked for, or the status that says why there is nothing.
    fn found(&self, request: &Request) -> Result<(&'static str, &[u8]), u16> {
        let mut hosts = request.headers().iter().filter(|h| h.field.equiv("Host"));
        match (hosts.next(), hosts.next()) {
            (Some(host), None) if self.hosts.iter().any(|known| host.value.as_str().eq_ignore_ascii_case(known)) => {}
            _ => return Err(403),
        }
        if *request.method() != Method::Get {
            return Err(405);
        }
        // Paths are names in a list, never those of files.
        let path = request.url().split('?').next().unwrap_or_default();
        match path {
            "/" => return Err(302),
            "/viewer/" => return package::file(PAGE).map(|page| (kind(PAGE), page)).ok_or(404),
            _ => {}
        }
        for (known, bytes) in [&self.file].into_iter().chain(&self.original) {
            if path == known {
                return Ok(("application/octet-stream", bytes));
            }
        }
        let name = path.strip_prefix('/').unwrap_or_default();
        package::file(name).map(|bytes| (kind(name), bytes)).ok_or(404)
    }
}

/// The media type of a file of the viewer.
fn kind(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("wasm") => "application/wasm",
        _ => "application/octet-stream",
    }
}

/// The answer without a body.
fn plain(status: u16, more: &[(&str, &str)]) -> Response<std::io::Empty> {
    Response::new(status.into(), headers(more), std::io::empty(), Some(0), None)
}

/// Headers of all answers, and `more`.
fn headers(more: &[(&str, &str)]) -> Vec<Header> {
    let all = [
        ("Cache-Control", "no-store"),
        ("Content-Security-Policy", POLICY),
        ("Cross-Origin-Resource-Policy", "same-origin"),
        ("Referrer-Policy", "no-referrer"),
        ("X-Content-Type-Options", "nosniff"),
    ];
    let header = |(name, value): &(&str, &str)| Header::from_bytes(*name, *value).expect("letters of headers");
    all.iter().chain(more).map(header).collect()
}

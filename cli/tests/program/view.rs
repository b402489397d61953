//! Guarantees of `ssplat view`: it serves the viewer and the named files, and nothing else, to this machine only; or it
//! writes them as one page.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../spec/vectors/valid/coded-rgb/file.ssplat");
const PHOTO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/images/kodim15.png");

fn view(input: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    command.arg("view").arg(input);
    command
}

/// Returns a source file of the viewer, which the program embeds. Its behaviour is tested in a browser (web/test).
fn source(name: &str) -> Vec<u8> {
    fs::read(Path::new("../web").join(name)).unwrap()
}

/// A server that ends with the test.
struct Serving {
    child: Child,
    /// Host and port.
    host: String,
    /// The path that is opened in the browser.
    path: String,
}

impl Serving {
    fn start(command: &mut Command) -> Serving {
        let mut child = command.arg("--no-open").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        let (host, path) = url.trim().strip_prefix("http://").expect(&url).split_once('/').unwrap();
        Serving { child, host: host.into(), path: format!("/{path}") }
    }

    /// Returns the whole response to `method path` with the given further header lines.
    fn ask(&self, method: &str, path: &str, head: &str) -> Vec<u8> {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        write!(stream, "{method} {path} HTTP/1.1\r\n{head}Connection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        answer
    }

    /// Returns status, head and body of a response to a browser.
    fn get(&self, path: &str) -> (u16, String, Vec<u8>) {
        let answer = self.ask("GET", path, &format!("Host: {}\r\n", self.host));
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(answer[..end].to_vec()).unwrap();
        (status(&answer), head, answer[end + 4..].to_vec())
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn status(answer: &[u8]) -> u16 {
    String::from_utf8_lossy(&answer[9..12]).parse().unwrap()
}

#[test]
fn head_gets_the_head_of_the_answer_to_get() {
    let served = Serving::start(&mut view(Path::new(FILE)));
    for path in ["/viewer/", "/", "/nowhere"] {
        let [get, head] = ["GET", "HEAD"].map(|method| served.ask(method, path, &format!("Host: {}\r\n", served.host)));
        let end = get.windows(4).position(|w| w == b"\r\n\r\n").unwrap() + 4;
        assert_eq!(head, &get[..end], "{path}");
    }
}

#[test]
fn the_viewer_and_the_named_files_are_served() {
    let served = Serving::start(view(Path::new(FILE)).args(["--original", PHOTO]));
    assert!(served.host.starts_with("127.0.0.1:"), "{}", served.host);
    assert_eq!(served.path, "/viewer/?file=/file/file.ssplat&original=/original/kodim15.png");
    let (status, head, body) = served.get(&served.path);
    assert_eq!((status, body.as_slice()), (200, source("viewer/index.html").as_slice()));
    for line in
        ["Content-Type: text/html", "X-Content-Type-Options: nosniff", "Content-Security-Policy: default-src 'none'"]
    {
        assert!(head.contains(line), "{line} is not in {head}");
    }
    assert_eq!(served.get("/file/file.ssplat").2, fs::read(FILE).unwrap());
    assert_eq!(served.get("/original/kodim15.png").2, fs::read(PHOTO).unwrap());
    let (status, head, body) = served.get("/ssplat-simd.wasm");
    assert_eq!((status, body.as_slice()), (200, source("ssplat-simd.wasm").as_slice()));
    assert!(head.contains("Content-Type: application/wasm"), "{head}");
    for name in ["ssplat-encode-simd.wasm", "ssplat-score-simd.wasm"] {
        let (status, head, body) = served.get(&format!("/{name}"));
        assert!(status == 200 && body == source(&format!("{name}.gz")), "{name}: {status}, {} bytes", body.len());
        assert!(head.contains("Content-Type: application/wasm") && head.contains("Content-Encoding: gzip"), "{head}");
    }
    // Every imported module exists.
    let mut names = ["/viewer/viewer.js", "/worker.js", "/encode.js", "/encode-worker.js"].map(String::from).to_vec();
    let mut seen = 0;
    while let Some(name) = names.get(seen).cloned() {
        let (status, _, body) = served.get(&name);
        assert_eq!((status, &body), (200, &source(name.trim_start_matches('/'))), "{name}");
        let folder = &name[..=name.rfind('/').unwrap()];
        for rest in String::from_utf8(body).unwrap().split("from \"").skip(1) {
            let named = rest.split('"').next().unwrap();
            let named = match named.strip_prefix("../") {
                Some(above) => format!("/{above}"),
                None => format!("{folder}{}", named.trim_start_matches("./")),
            };
            if !names.contains(&named) {
                names.push(named);
            }
        }
        seen += 1;
    }
    assert!(seen > 10, "{names:?}");
    let (status, head, _) = served.get("/");
    assert!(status == 302 && head.contains(&format!("Location: {}", served.path)), "{head}");
}

#[test]
fn without_a_file_the_page_that_encodes_is_served() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    let served = Serving::start(command.arg("view"));
    assert_eq!(served.path, "/viewer/");
    assert_eq!(served.get(&served.path).2, source("viewer/index.html"));
    let (status, head, _) = served.get("/");
    assert!(status == 302 && head.contains("Location: /viewer/\r\n"), "{head}");
    // The pictures that the page offers.
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../web/viewer/samples");
    let names: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names.len(), 3, "{names:?}");
    for name in names {
        let name = format!("viewer/samples/{}", name.to_str().unwrap());
        let (status, _, body) = served.get(&format!("/{name}"));
        assert!(status == 200 && body == source(&name), "{name}: {status}");
    }
    for option in ["--html", "--original"] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
        refused(command.args(["view", option, "-"]).output().unwrap(), 2, &["INPUT"]);
    }
}

#[test]
fn a_compressed_original_is_not_unpacked() {
    let folder = tempfile::tempdir().unwrap();
    let original = folder.path().join("drawing.svgz");
    fs::write(&original, [0x1f, 0x8b, 8, 0]).unwrap();
    let served = Serving::start(view(Path::new(FILE)).arg("--original").arg(&original));
    let (_, head, body) = served.get("/original/drawing.svgz");
    assert!(body == [0x1f, 0x8b, 8, 0] && !head.contains("Content-Encoding"), "{head}");
}

#[test]
fn nothing_else_is_served_and_other_hosts_are_refused() {
    let served = Serving::start(&mut view(Path::new(FILE)));
    for path in [
        "/build",
        "/package.json",
        "/Cargo.toml",
        "/file/",
        "/file/other.ssplat",
        "/viewer/../error.js",
        "/viewer/..%2ferror.js",
        "//etc/passwd",
        "/../../../../etc/passwd",
        "/%2e%2e/Cargo.toml",
        "/viewer",
    ] {
        assert_eq!(served.get(path).0, 404, "{path}");
    }
    let host = format!("Host: {}\r\n", served.host);
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "NONSENSE"] {
        assert_eq!(status(&served.ask(method, &served.path, &host)), 405, "{method}");
    }
    let port = served.host.rsplit(':').next().unwrap();
    for head in [
        String::new(),
        "Host: rebound.example\r\n".into(),
        format!("Host: rebound.example:{port}\r\n"),
        "Host: 127.0.0.1\r\n".into(),
        format!("{host}Host: rebound.example\r\n"),
    ] {
        assert_eq!(status(&served.ask("GET", "/file/file.ssplat", &head)), 403, "{head:?}");
    }
    assert_eq!(status(&served.ask("GET", "/file/file.ssplat", &format!("Host: localhost:{port}\r\n"))), 200);
}

#[test]
fn a_file_is_read_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a picture.ssplat");
    fs::copy(FILE, &path).unwrap();
    let served = Serving::start(&mut view(&path));
    fs::remove_file(&path).unwrap();
    assert_eq!(served.path, "/viewer/?file=/file/a_picture.ssplat");
    assert_eq!(served.get("/file/a_picture.ssplat").2, fs::read(FILE).unwrap());
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_the_server() {
    let mut served = Serving::start(&mut view(Path::new(FILE)));
    nix::sys::signal::kill(nix::unistd::Pid::from_raw(served.child.id() as i32), nix::sys::signal::Signal::SIGINT)
        .unwrap();
    assert_eq!(served.child.wait().unwrap().code(), Some(130));
}

#[test]
fn one_page_contains_everything() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("page.html");
    let done = view(Path::new(FILE)).args(["--original", PHOTO, "--html"]).arg(&out).output().unwrap();
    assert!(done.status.success(), "{done:?}");
    let page = fs::read_to_string(&out).unwrap();
    for (id, name, bytes) in [
        ("held-module", "ssplat-simd.wasm", source("ssplat-simd.wasm")),
        ("held-file", "file.ssplat", fs::read(FILE).unwrap()),
        ("held-original", "kodim15.png", fs::read(PHOTO).unwrap()),
    ] {
        let start = format!("id=\"{id}\" data-name=\"{name}\">");
        let text =
            page.split(&start).nth(1).and_then(|rest| rest.split('<').next()).unwrap_or_else(|| panic!("no {start}"));
        assert_eq!(STANDARD.decode(text).unwrap(), bytes, "{id}");
    }
    // The modules import the names of the import map.
    let viewer = String::from_utf8(source("viewer/viewer.js")).unwrap();
    let module = STANDARD.encode(viewer.replace("from \"./", "from \"ssplat/").replace("from \"../", "from \"ssplat/"));
    assert!(page.contains(&format!("\"ssplat/viewer.js\":\"data:text/javascript;base64,{module}\"")));
    assert!(!page.contains("src="), "the page asks for more");
    assert!(page.starts_with("<!doctype html>\n") && page.ends_with("\n</html>\n"));
}

#[track_caller]
fn refused(output: Output, status: i32, words: &[&str]) {
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.code() == Some(status) && words.iter().all(|w| error.contains(w)),
        "{:?}: {error}",
        output.status
    );
}

#[test]
fn invalid_files_are_refused_before_a_browser_is_opened() {
    let broken = concat!(env!("CARGO_MANIFEST_DIR"), "/../spec/vectors/invalid/checksum/file.ssplat");
    for (input, status) in [("nowhere.ssplat", 3), (broken, 4), (PHOTO, 4)] {
        refused(view(Path::new(input)).args(["--html", "-"]).output().unwrap(), status, &[input]);
    }
    let nowhere = view(Path::new(FILE)).args(["--html", "-", "--original", "nowhere.png"]).output().unwrap();
    refused(nowhere, 3, &["nowhere.png"]);
}

#[test]
fn the_program_embeds_the_viewer() {
    let folder = tempfile::tempdir().unwrap();
    let [program, file] = ["ssplat", "picture.ssplat"].map(|name| folder.path().join(name));
    fs::copy(env!("CARGO_BIN_EXE_ssplat"), &program).unwrap();
    fs::copy(FILE, &file).unwrap();
    let mut command = Command::new(&program);
    command.current_dir(folder.path()).args(["view", "picture.ssplat", "--html", "-"]);
    let done = command.output().unwrap();
    assert!(done.status.success() && done.stdout.len() > 300_000, "{:?}", done.status);
}

#[test]
fn hostile_requests_do_not_block_others_and_are_closed() {
    let folder = tempfile::tempdir().unwrap();
    let original = folder.path().join("large.png");
    fs::write(&original, vec![7; 64 << 20]).unwrap();
    let served = Serving::start(view(Path::new(FILE)).arg("--original").arg(&original));
    let connect = || TcpStream::connect(&served.host).unwrap();
    // More clients that read nothing than there are threads, and as many that send nothing.
    let mut open = Vec::new();
    for i in 0..16 {
        let mut stream = connect();
        if i % 2 == 0 {
            write!(stream, "GET /original/large.png HTTP/1.1\r\nHost: {}\r\n\r\n", served.host).unwrap();
        }
        open.push(stream);
    }
    let start = Instant::now();
    assert_eq!(served.get("/file/file.ssplat").0, 200);
    // The server does not wait for a body.
    let mut stream = connect();
    write!(stream, "POST / HTTP/1.1\r\nHost: {}\r\nContent-Length: 1000\r\n\r\n", served.host).unwrap();
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).unwrap();
    assert_eq!(status(&answer), 405);
    // An endless line is not read completely.
    let mut stream = connect();
    write!(stream, "GET /{} ", "a".repeat(40_000)).unwrap();
    stream.read_exact(&mut answer).unwrap();
    assert_eq!(status(&answer), 431);
    assert!(start.elapsed() < Duration::from_secs(4), "{:?}", start.elapsed());
    // Further connections wait without threads until the idle ones time out.
    open.extend((0..40).map(|_| connect()));
    assert_eq!(served.get("/file/file.ssplat").0, 200);
    #[cfg(target_os = "linux")]
    {
        let said = fs::read_to_string(format!("/proc/{}/status", served.child.id())).unwrap();
        let threads = said.lines().find_map(|line| line.strip_prefix("Threads:")).unwrap();
        assert!(threads.trim().parse::<u32>().unwrap() < 60, "{threads}");
    }
}

/// Desktops start the viewer without a terminal, from which a user could end it.
#[test]
fn the_viewer_ends_by_itself_when_nothing_is_requested() {
    let mut serving = Serving::start(view(Path::new(FILE)).args(["--idle", "1"]));
    assert_eq!(serving.get(&serving.path.clone()).0, 200);
    assert!(serving.child.wait().unwrap().success());
    let refused = view(Path::new(FILE)).args(["--idle", "0"]).output().unwrap();
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("--idle"));
}

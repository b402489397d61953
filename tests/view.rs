//! What `ssplat view` promises: the viewer and the files named, to this machine alone, and nothing else; or one page of them.
#![cfg(feature = "cli")]

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

const FILE: &str = "spec/vectors/valid/coded-rgb/file.ssplat";
const PHOTO: &str = "tests/images/kodim15.png";
const PAGE: &str = "<!doctype html><title>v</title>\n<script type=\"module\" src=\"viewer.js\"></script>\n</html>\n";

/// A folder with files of the viewer's names. What they do is tried in a browser (web/test).
fn stand_in() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("viewer")).unwrap();
    fs::write(folder.path().join("viewer/index.html"), PAGE).unwrap();
    let modules = [
        "error",
        "icc",
        "machine",
        "ssplat",
        "worker",
        "viewer/gaussians",
        "viewer/scene",
        "viewer/splatting",
        "viewer/viewer",
        "viewer/webgpu",
    ];
    for name in modules {
        let text = format!("import {{ x }} from \"../machine.js\" // {name}\n");
        fs::write(folder.path().join(format!("{name}.js")), text).unwrap();
    }
    for kind in ["simd", "scalar"] {
        fs::write(folder.path().join(format!("ssplat-{kind}.wasm")), kind).unwrap();
    }
    folder
}

fn view(viewer: &Path, input: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    command.arg("view").arg(input).env_remove("SSPLAT_VIEWER").arg("--viewer").arg(viewer);
    command
}

/// A server that is ended with the test.
struct Serving {
    child: Child,
    /// Host and port.
    host: String,
    /// What is to be opened in the browser.
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

    /// The whole answer to `method path` with the head's other lines.
    fn ask(&self, method: &str, path: &str, head: &str) -> Vec<u8> {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        write!(stream, "{method} {path} HTTP/1.1\r\n{head}Connection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        answer
    }

    /// Status, head and body of what a browser gets.
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
fn the_viewer_and_the_named_files_are_served() {
    let viewer = stand_in();
    let served = Serving::start(view(viewer.path(), Path::new(FILE)).args(["--original", PHOTO]));
    assert!(served.host.starts_with("127.0.0.1:"), "{}", served.host);
    assert_eq!(served.path, "/viewer/?file=/file/file.ssplat&original=/original/kodim15.png");
    let (status, head, body) = served.get(&served.path);
    assert_eq!((status, body.as_slice()), (200, PAGE.as_bytes()));
    for line in
        ["Content-Type: text/html", "X-Content-Type-Options: nosniff", "Content-Security-Policy: default-src 'none'"]
    {
        assert!(head.contains(line), "{line} is not in {head}");
    }
    assert_eq!(served.get("/file/file.ssplat").2, fs::read(FILE).unwrap());
    assert_eq!(served.get("/original/kodim15.png").2, fs::read(PHOTO).unwrap());
    let (status, head, body) = served.get("/ssplat-simd.wasm");
    assert_eq!((status, body.as_slice()), (200, &b"simd"[..]));
    assert!(head.contains("Content-Type: application/wasm"), "{head}");
    let (status, head, _) = served.get("/");
    assert!(status == 302 && head.contains(&format!("Location: {}", served.path)), "{head}");
}

#[test]
fn nothing_else_is_served_to_nobody_else() {
    let viewer = stand_in();
    fs::write(viewer.path().join("secret.js"), "secret").unwrap();
    let served = Serving::start(&mut view(viewer.path(), Path::new(FILE)));
    for path in [
        "/secret.js",
        "/file/",
        "/file/other.ssplat",
        "/viewer/../secret.js",
        "/viewer/..%2fsecret.js",
        "//etc/passwd",
        "/../../../../etc/passwd",
        "/%2e%2e/Cargo.toml",
        "/viewer",
    ] {
        assert_eq!(served.get(path).0, 404, "{path}");
    }
    let host = format!("Host: {}\r\n", served.host);
    for method in ["POST", "PUT", "DELETE", "HEAD", "OPTIONS", "NONSENSE"] {
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
    let viewer = stand_in();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a picture.ssplat");
    fs::copy(FILE, &path).unwrap();
    let served = Serving::start(&mut view(viewer.path(), &path));
    fs::remove_file(&path).unwrap();
    assert_eq!(served.path, "/viewer/?file=/file/a_picture.ssplat");
    assert_eq!(served.get("/file/a_picture.ssplat").2, fs::read(FILE).unwrap());
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_the_server() {
    let viewer = stand_in();
    let mut served = Serving::start(&mut view(viewer.path(), Path::new(FILE)));
    nix::sys::signal::kill(nix::unistd::Pid::from_raw(served.child.id() as i32), nix::sys::signal::Signal::SIGINT)
        .unwrap();
    assert_eq!(served.child.wait().unwrap().code(), Some(130));
}

#[test]
fn one_page_holds_everything() {
    let viewer = stand_in();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("page.html");
    let done = view(viewer.path(), Path::new(FILE)).args(["--original", PHOTO, "--html"]).arg(&out).output().unwrap();
    assert!(done.status.success(), "{done:?}");
    let page = fs::read_to_string(&out).unwrap();
    for (id, name, bytes) in [
        ("held-module", "ssplat-scalar.wasm", b"scalar".to_vec()),
        ("held-file", "file.ssplat", fs::read(FILE).unwrap()),
        ("held-original", "kodim15.png", fs::read(PHOTO).unwrap()),
    ] {
        let start = format!("id=\"{id}\" data-name=\"{name}\">");
        let text =
            page.split(&start).nth(1).and_then(|rest| rest.split('<').next()).unwrap_or_else(|| panic!("no {start}"));
        assert_eq!(STANDARD.decode(text).unwrap(), bytes, "{id}");
    }
    let module = STANDARD.encode("import { x } from \"ssplat/machine.js\" // viewer/viewer\n");
    assert!(page.contains(&format!("\"ssplat/viewer.js\":\"data:text/javascript;base64,{module}\"")));
    assert!(!page.contains("src="), "the page asks for more");
    assert!(page.starts_with("<!doctype html><title>v</title>\n") && page.ends_with("\n</html>\n"));
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
fn what_cannot_be_shown_is_refused_before_a_browser_is_asked() {
    let viewer = stand_in();
    let broken = "spec/vectors/invalid/checksum/file.ssplat";
    for (input, status) in [("nowhere.ssplat", 3), (broken, 4), (PHOTO, 4)] {
        refused(view(viewer.path(), Path::new(input)).args(["--html", "-"]).output().unwrap(), status, &[input]);
    }
    let nowhere =
        view(viewer.path(), Path::new(FILE)).args(["--html", "-", "--original", "nowhere.png"]).output().unwrap();
    refused(nowhere, 3, &["nowhere.png"]);
    fs::write(viewer.path().join("viewer/index.html"), "<p>another page").unwrap();
    let page = viewer.path().join("page.html");
    refused(view(viewer.path(), Path::new(FILE)).arg("--html").arg(&page).output().unwrap(), 4, &["index.html"]);
    assert!(!page.exists());
    fs::remove_file(viewer.path().join("ssplat.js")).unwrap();
    refused(view(viewer.path(), Path::new(FILE)).args(["--html", "-"]).output().unwrap(), 3, &["ssplat.js"]);
}

#[test]
fn without_a_viewer_the_program_says_how_to_get_one() {
    let folder = tempfile::tempdir().unwrap();
    let program: PathBuf = folder.path().join("bin").join("ssplat");
    fs::create_dir(program.parent().unwrap()).unwrap();
    fs::copy(env!("CARGO_BIN_EXE_ssplat"), &program).unwrap();
    let run = || {
        let mut command = Command::new(&program);
        command.args(["view", FILE, "--html", "-"]).env_remove("SSPLAT_VIEWER");
        command
    };
    refused(run().output().unwrap(), 3, &["web/build", "--viewer", "SSPLAT_VIEWER"]);
    // A variable names the folder; a viewer that is installed beside the program needs none.
    let viewer = stand_in();
    assert!(run().env("SSPLAT_VIEWER", viewer.path()).output().unwrap().status.success());
    fs::create_dir(folder.path().join("share")).unwrap();
    fs::create_dir(folder.path().join("share/ssplat")).unwrap();
    fs::rename(viewer.path(), folder.path().join("share/ssplat/web")).unwrap();
    assert!(run().output().unwrap().status.success());
}

//! Guarantees about input pictures: memory is bounded whatever a file claims, broken files stop no other, and inputs
//! need not seek.

use std::ffi::OsStr;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use crate::folder::Folder;
use nix::sys::resource::{Resource, setrlimit};

/// Address space of the program: less than the 8 GiB that a picture may take, so that memory that is allocated and
/// never touched is detected as well.
const ADDRESS_SPACE: u64 = 6_000_000_000;

/// A process that takes longer than this hangs.
const PATIENCE: Duration = Duration::from_secs(60);

/// Runs the program; the address space of the test bounds that of the program.
fn ssplat<S: AsRef<OsStr>>(args: &[S]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    command.args(args.iter().map(AsRef::as_ref)).stdin(Stdio::null());
    finished(command)
}

/// Returns the output of `command`; panics if it hangs.
fn finished(mut command: Command) -> Output {
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let id = child.id();
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    receiver.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("process {id} hangs")).unwrap()
}

fn bound_address_space() {
    setrlimit(Resource::RLIMIT_AS, ADDRESS_SPACE, ADDRESS_SPACE).unwrap();
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Returns a picture of ramps as a file of `format`.
fn picture(format: image::ImageFormat) -> Vec<u8> {
    let picture = image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([x as u8 * 6, y as u8 * 8, 90]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::DynamicImage::from(picture).write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// A TIFF of 20 × 20 pixels with separate planes in tiles. It is valid, and `tiff` 0.11.3 panics on it
/// (image-rs/image-tiff#403).
fn tiled_planar() -> Vec<u8> {
    let [side, tile, planes] = [20u32, 16, 3];
    let count = planes * side.div_ceil(tile).pow(2);
    let samples = 8;
    let offsets = samples + count * tile * tile;
    let counts = offsets + 4 * count;
    let bits = counts + 4 * count;
    let directory = bits + 6;
    let mut file = b"II*\0".to_vec();
    file.extend(directory.to_le_bytes());
    file.extend((0..count * tile * tile).map(|i| i as u8));
    file.extend((0..count).flat_map(|i| (samples + i * tile * tile).to_le_bytes()));
    file.extend((0..count).flat_map(|_| (tile * tile).to_le_bytes()));
    file.extend([8, 0, 8, 0, 8, 0]);
    // Tag, type (3: SHORT, 4: LONG), count, value.
    let entries: [(u16, u16, u32, u32); 12] = [
        (256, 4, 1, side),
        (257, 4, 1, side),
        (258, 3, planes, bits),
        (259, 3, 1, 1),
        (262, 3, 1, 2),
        (277, 3, 1, planes),
        (284, 3, 1, 2),
        (322, 4, 1, tile),
        (323, 4, 1, tile),
        (324, 4, count, offsets),
        (325, 4, count, counts),
        (339, 3, 1, 1),
    ];
    file.extend((entries.len() as u16).to_le_bytes());
    for (tag, kind, count, value) in entries {
        file.extend(tag.to_le_bytes().into_iter().chain(kind.to_le_bytes()));
        file.extend(count.to_le_bytes().into_iter().chain(value.to_le_bytes()));
    }
    file.extend([0; 4]);
    file
}

/// Tiny files that claim huge pictures: name and bytes.
fn bombs() -> Vec<(&'static str, Vec<u8>)> {
    let pam = "P7\nWIDTH 524288\nHEIGHT 524288\nDEPTH 4\nMAXVAL 255\nTUPLTYPE RGB_ALPHA\nENDHDR\n";
    let gif =
        [&b"GIF89a\xFF\xFF\xFF\xFF\0\0\0,\0\0\0\0\xFF\xFF\xFF\xFF\x80\0\0\0\xFF\xFF\xFF\x02\x02D\x01\0;"[..]].concat();
    let farbfeld = [&b"farbfeld"[..], &60000u32.to_be_bytes(), &60000u32.to_be_bytes(), &[9; 200]].concat();
    // A baseline JPEG with a false frame header.
    let mut jpeg = picture(image::ImageFormat::Jpeg);
    let frame = jpeg.windows(2).position(|w| w == [0xFF, 0xC0]).unwrap();
    jpeg[frame + 5..frame + 9].fill(0xFF);
    let netpbm = b"P6\n1000000\n1000000\n65535\n".to_vec();
    vec![
        ("pam.pam", pam.into()),
        ("gif.gif", gif),
        ("farbfeld.ff", farbfeld),
        ("jpeg.jpg", jpeg),
        ("netpbm.ppm", netpbm),
    ]
}

#[test]
fn a_tiny_file_that_says_it_is_huge_is_refused_in_little_memory() {
    bound_address_space();
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    for (name, bytes) in bombs() {
        let input = folder.file(name, &bytes);
        for command in ["encode", "compare", "placeholder"] {
            let mut args = vec![OsStr::new(command), input.as_os_str()];
            match command {
                "encode" => args.push(out.as_os_str()),
                "compare" => args.push(input.as_os_str()),
                _ => {}
            }
            let found = ssplat(&args);
            let said = said(&found);
            // For a PNM that is read in parts, the length of the file is checked first.
            let status = if (command, name) == ("encode", "netpbm.ppm") { 4 } else { 6 };
            assert_eq!(found.status.code(), Some(status), "{command} {name}: {said}");
            assert!(said.contains(name) && !said.contains("panicked"), "{command} {name}: {said}");
        }
    }
    assert!(!out.exists());
}

#[test]
fn an_endless_ssplat_file_is_refused_by_its_length() {
    bound_address_space();
    let folder = Folder::new();
    let input = folder.file("big.ssplat", b"\x89SSP\x06\x92");
    fs::File::options().write(true).open(&input).unwrap().set_len(12 << 30).unwrap();
    let [path, out] = [input.to_str().unwrap(), folder.path("o.ssplat").to_str().unwrap()].map(str::to_owned);
    for args in
        [vec!["compare", &path, &path], vec!["encode", &path, &out], vec!["placeholder", &path], vec!["info", &path]]
    {
        let found = ssplat(&args);
        assert_eq!(found.status.code(), Some(6), "{args:?}: {}", said(&found));
        assert!(said(&found).contains("is longer than"), "{}", said(&found));
    }
}

#[test]
fn a_picture_at_which_a_decoder_panics_or_asks_for_too_much_stops_no_other() {
    bound_address_space();
    let folder = Folder::new();
    let (inside, out) = (folder.path("in"), folder.path("out"));
    fs::create_dir(&inside).unwrap();
    fs::write(inside.join("a.png"), picture(image::ImageFormat::Png)).unwrap();
    fs::write(inside.join("b.tif"), tiled_planar()).unwrap();
    for (name, bytes) in bombs() {
        fs::write(inside.join(name), bytes).unwrap();
    }
    fs::write(inside.join("z.png"), picture(image::ImageFormat::Png)).unwrap();
    let paths = [&inside, &out].map(|path| path.to_str().unwrap());
    let found = ssplat(&["encode", paths[0], "--out-dir", paths[1], "--jobs", "1", "--effort", "1", "--bytes", "300"]);
    let said = said(&found);
    assert_eq!(found.status.code(), Some(1), "{said}");
    assert!(out.join("a.ssplat").exists() && out.join("z.ssplat").exists(), "{said}");
    assert!(said.contains("6 of 8 files failed") && !said.contains("panicked"), "{said}");
    let alone = ssplat(&["compare", inside.join("b.tif").to_str().unwrap(), inside.join("b.tif").to_str().unwrap()]);
    let said = self::said(&alone);
    assert_eq!(alone.status.code(), Some(4), "{said}");
    assert!(said.contains("b.tif") && said.contains("decoder") && !said.contains("panicked"), "{said}");
}

/// Runs the program with `args`, where `{}` stands for a FIFO that `bytes` are written to.
fn through_fifo(folder: &Folder, name: &str, args: &[&str], bytes: &[u8]) -> Output {
    let fifo = folder.path(name);
    nix::unistd::mkfifo(&fifo, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let (path, bytes) = (fifo.clone(), bytes.to_vec());
    std::thread::spawn(move || fs::File::options().write(true).open(path).and_then(|mut f| f.write_all(&bytes)));
    let args: Vec<&str> = args.iter().map(|&a| if a == "{}" { fifo.to_str().unwrap() } else { a }).collect();
    let found = ssplat(&args);
    fs::remove_file(fifo).unwrap();
    found
}

#[test]
fn what_cannot_seek_is_read_as_a_file_is() {
    let folder = Folder::new();
    let png = picture(image::ImageFormat::Png);
    let file = folder.file("a.png", &png);
    let file = file.to_str().unwrap();
    let [expected, out] = ["e.ssplat", "o.ssplat"].map(|n| folder.path(n).to_str().unwrap().to_owned());
    let options = ["--effort", "1", "--bytes", "300"];
    assert!(ssplat(&[&["encode", file, &expected][..], &options].concat()).status.success());
    let expected = fs::read(expected).unwrap();
    // Without an extension, with one, and in tiles.
    for (name, more) in [("fifo", &[][..]), ("fifo.png", &[]), ("fifo.png", &["--tiles=128"])] {
        let found =
            through_fifo(&folder, name, &[&["encode", "{}", &out, "--force"][..], &options, more].concat(), &png);
        assert!(found.status.success(), "{name}: {}", said(&found));
        if more.is_empty() {
            assert!(fs::read(&out).unwrap() == expected, "{name}");
        }
    }
    let dir = folder.path("out");
    let dir = dir.to_str().unwrap();
    let found = through_fifo(&folder, "f", &[&["encode", "{}", "--out-dir", dir][..], &options].concat(), &png);
    assert!(found.status.success(), "{}", said(&found));
    assert!(fs::read(Path::new(dir).join("f.ssplat")).unwrap() == expected);
    let found = through_fifo(&folder, "f", &["compare", "{}", file], &png);
    assert!(String::from_utf8_lossy(&found.stdout).contains("identical samples"), "{}", said(&found));
    let found = through_fifo(&folder, "f", &["placeholder", "{}"], &png);
    assert!(found.status.success() && found.stdout.len() > 100, "{}", said(&found));
    // Standard input as a path.
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    command.args(["compare", "/dev/stdin", file]);
    let (reader, mut writer) = std::io::pipe().unwrap();
    command.stdin(reader);
    std::thread::spawn(move || writer.write_all(&png));
    let found = finished(command);
    assert!(String::from_utf8_lossy(&found.stdout).contains("identical samples"), "{}", said(&found));
}

#[test]
fn of_what_is_endless_and_no_picture_only_the_start_is_read() {
    bound_address_space();
    for args in [&["placeholder", "/dev/zero"][..], &["compare", "/dev/zero", "/dev/zero"], &["info", "/dev/zero"]] {
        let found = ssplat(args);
        assert!(matches!(found.status.code(), Some(4 | 5)), "{args:?}: {}", said(&found));
    }
}

#[test]
fn pipes_in_folders_are_passed_over() {
    let folder = Folder::new();
    let (inside, out) = (folder.path("in"), folder.path("out"));
    fs::create_dir(&inside).unwrap();
    fs::write(inside.join("a.png"), picture(image::ImageFormat::Png)).unwrap();
    for name in ["b.png", "without-extension"] {
        nix::unistd::mkfifo(&inside.join(name), nix::sys::stat::Mode::S_IRWXU).unwrap();
    }
    let paths = [&inside, &out].map(|path| path.to_str().unwrap());
    let found = ssplat(&["encode", paths[0], "--out-dir", paths[1], "--effort", "1", "--bytes", "300"]);
    assert!(found.status.success(), "{}", said(&found));
    assert!(said(&found).contains("2 files are passed over"), "{}", said(&found));
    assert!(out.join("a.ssplat").exists());
}

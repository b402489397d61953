//! Two services over the library, which is synchronous: work on the processor runs on tokio's threads for blocking work.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path as Parts, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use ssplat::{Encoder, Error, Limits, Reader, Rect};
use tokio::sync::Semaphore;
use tokio::task::spawn_blocking;
use tower_http::services::ServeFile;

/// Side of a tile, pixels.
const TILE: u32 = 256;

/// Largest picture that is taken for encoding, bytes.
const MOST_BYTES: usize = 32 << 20;

/// Tiles of the file at `path`, and the file itself by ranges, for clients that decode:
///
/// - `/tile/Z/X/Y.png`: tile X, Y of 256 × 256 pixels of the picture at 1 / 2^Z of its size.
/// - `/file.ssplat`: the file; requests with a range get that part.
///
/// The file is opened once. Each tile reads only the bytes that it needs, so a tile with few Gaussians is fast.
///
/// # Errors
/// As [`Reader::open`].
pub fn tiles(path: &Path) -> ssplat::Result<Router> {
    let reader = Arc::new(Reader::open(path, &Limits::default())?);
    let file = ServeFile::new_with_mime(path, &"image/x-ssplat".parse().expect("a media type"));
    Ok(Router::new().route("/tile/{z}/{x}/{name}", get(tile)).with_state(reader).route_service("/file.ssplat", file))
}

async fn tile(
    State(reader): State<Arc<Reader<'static>>>,
    Parts((z, x, name)): Parts<(u32, u32, String)>,
) -> Result<Response, Refusal> {
    let y = name.strip_suffix(".png").and_then(|y| y.parse().ok()).ok_or(Refusal::NoTile)?;
    let png = spawn_blocking(move || draw(&reader, z, x, y)).await.map_err(|_| Refusal::Broken)??;
    let headers = [(header::CONTENT_TYPE, "image/png"), (header::CACHE_CONTROL, "public, max-age=86400")];
    Ok((headers, png).into_response())
}

/// Draws a tile; those at the right and lower edges are smaller.
fn draw(reader: &Reader<'_>, z: u32, x: u32, y: u32) -> Result<Vec<u8>, Refusal> {
    let side = TILE.checked_shl(z).filter(|side| side >> z == TILE).ok_or(Refusal::NoTile)?;
    let start = |tile: u32, whole: u32| tile.checked_mul(side).filter(|&at| at < whole).ok_or(Refusal::NoTile);
    let (left, top) = (start(x, reader.width())?, start(y, reader.height())?);
    let part = Rect::new(left, top, side.min(reader.width() - left), side.min(reader.height() - top));
    let view = reader.view().crop(part)?.resized(part.width.div_ceil(1 << z), part.height.div_ceil(1 << z))?;
    let pixels = reader.read_for(&view)?.render(&view)?;
    let mut png = std::io::Cursor::new(Vec::new());
    image::DynamicImage::from(pixels).write_to(&mut png, image::ImageFormat::Png).map_err(|_| Refusal::Broken)?;
    Ok(png.into_inner())
}

/// `POST /encode` with a JPEG or PNG returns an `.ssplat` file. At most `at_once` pictures are encoded at a time, and an
/// encode ends when its client goes away, or after ten seconds with the best file until then.
pub fn encodes(at_once: usize) -> Router {
    let turns = Arc::new(Semaphore::new(at_once));
    Router::new().route("/encode", post(encode)).layer(DefaultBodyLimit::max(MOST_BYTES)).with_state(turns)
}

/// Tells an encode to stop when it is dropped.
struct Stop(Arc<AtomicBool>);

impl Drop for Stop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

async fn encode(State(turns): State<Arc<Semaphore>>, body: Bytes) -> Result<Response, Refusal> {
    let turn = turns.acquire_owned().await.map_err(|_| Refusal::Broken)?;
    let stop = Arc::new(AtomicBool::new(false));
    // axum drops this function, and with it the guard, when the client goes away.
    let _guard = Stop(stop.clone());
    let work = spawn_blocking(move || {
        // A blocking task is not dropped, so the turn is held until the encode has really ended.
        let _turn = turn;
        encode_unless(&body, &stop)
    });
    let file = work.await.map_err(|_| Refusal::Broken)??;
    Ok(([(header::CONTENT_TYPE, "image/x-ssplat")], file).into_response())
}

/// Encodes a picture; [`Error::Cancelled`] soon after `stop` is set.
fn encode_unless(picture: &[u8], stop: &AtomicBool) -> Result<Vec<u8>, Refusal> {
    let picture = image::load_from_memory(picture).map_err(|_| Refusal::NoPicture)?;
    let encoder = Encoder::new().effort(3).time(std::time::Duration::from_secs(10));
    let encoded = encoder.encode_with_progress(&picture, &mut |_| match stop.load(Ordering::Relaxed) {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    })?;
    Ok(encoded.bytes)
}

/// Why a request fails.
#[derive(Debug)]
enum Refusal {
    NoTile,
    NoPicture,
    Broken,
    Library(Error),
}

impl From<Error> for Refusal {
    fn from(error: Error) -> Self {
        Refusal::Library(error)
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        match self {
            Refusal::NoTile => (StatusCode::NOT_FOUND, "no such tile").into_response(),
            Refusal::NoPicture => (StatusCode::UNSUPPORTED_MEDIA_TYPE, "neither JPEG nor PNG").into_response(),
            Refusal::Broken => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
            Refusal::Library(error) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::{Body, to_bytes};
    use axum::http::Request;
    use tower::ServiceExt;

    /// A file of the conformance vectors.
    fn file() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../spec/vectors/valid/coded-rgb/file.ssplat")
    }

    async fn answer(service: &Router, request: Request<Body>) -> (StatusCode, Vec<u8>) {
        let response = service.clone().oneshot(request).await.unwrap();
        let status = response.status();
        (status, to_bytes(response.into_body(), 1 << 20).await.unwrap().to_vec())
    }

    fn asking(path: &str) -> Request<Body> {
        Request::get(path).body(Body::empty()).unwrap()
    }

    #[tokio::test]
    async fn tiles_are_parts_of_the_picture() {
        let (service, bytes) = (tiles(&file()).unwrap(), std::fs::read(file()).unwrap());
        let whole = Reader::new(&bytes, &Limits::default()).unwrap();
        let pixels = whole.read().unwrap().render(&whole.view()).unwrap();
        assert!(whole.width() <= TILE && whole.height() <= TILE, "one tile");
        let (status, png) = answer(&service, asking("/tile/0/0/0.png")).await;
        assert_eq!(status, StatusCode::OK);
        assert_eq!(image::load_from_memory(&png).unwrap(), image::DynamicImage::from(pixels));
        let (_, png) = answer(&service, asking("/tile/1/0/0.png")).await;
        let half = image::load_from_memory(&png).unwrap();
        assert_eq!((half.width(), half.height()), (whole.width().div_ceil(2), whole.height().div_ceil(2)));
        for beyond in ["/tile/0/1/0.png", "/tile/0/0/0.jpg", "/tile/40/0/0.png", "/tile/0/4294967295/0.png"] {
            assert_eq!(answer(&service, asking(beyond)).await.0, StatusCode::NOT_FOUND, "{beyond}");
        }
    }

    #[tokio::test]
    async fn a_range_of_the_file_is_served() {
        let request = Request::get("/file.ssplat").header(header::RANGE, "bytes=4-9").body(Body::empty()).unwrap();
        let (status, part) = answer(&tiles(&file()).unwrap(), request).await;
        assert_eq!((status, &part[..]), (StatusCode::PARTIAL_CONTENT, &std::fs::read(file()).unwrap()[4..10]));
    }

    #[tokio::test]
    async fn an_encode_ends_when_its_request_is_dropped() {
        let turns = Arc::new(Semaphore::new(1));
        let mut png = std::io::Cursor::new(Vec::new());
        let noise = image::RgbImage::from_fn(512, 512, |x, y| {
            image::Rgb([(x * y % 251) as u8, (x * x % 241) as u8, (y * 7) as u8])
        });
        noise.write_to(&mut png, image::ImageFormat::Png).unwrap();
        let request = tokio::spawn(encode(State(turns.clone()), png.into_inner().into()));
        while turns.available_permits() > 0 {
            tokio::task::yield_now().await;
        }
        request.abort();
        assert!(request.await.unwrap_err().is_cancelled());
        // The turn is free once the encode has noticed.
        let _turn = turns.acquire().await.unwrap();
    }

    #[test]
    fn an_encode_that_is_told_to_stop_is_cancelled() {
        let mut png = std::io::Cursor::new(Vec::new());
        image::RgbImage::new(64, 64).write_to(&mut png, image::ImageFormat::Png).unwrap();
        let stopped = encode_unless(png.get_ref(), &AtomicBool::new(true));
        assert!(matches!(stopped, Err(Refusal::Library(Error::Cancelled))), "{stopped:?}");
        assert!(encode_unless(png.get_ref(), &AtomicBool::new(false)).is_ok());
        assert!(matches!(encode_unless(b"text", &AtomicBool::new(false)), Err(Refusal::NoPicture)));
    }
}

//! Serves tiles of a file, and encodes pictures, at http://127.0.0.1:8080:
//!
//! ```text
//! cd examples/services && cargo run --release -- map.ssplat
//! curl http://127.0.0.1:8080/tile/2/0/0.png --output tile.png
//! curl http://127.0.0.1:8080/file.ssplat --range 0-1023 --output start
//! curl http://127.0.0.1:8080/encode --data-binary @photo.jpg --output photo.ssplat
//! ```

use std::error::Error;

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args_os().nth(1).ok_or("the path of an .ssplat file")?;
    let service = ssplat_services::tiles(path.as_ref())?.merge(ssplat_services::encodes(2));
    let listener = tokio::net::TcpListener::bind("127.0.0.1:8080").await?;
    println!("http://{}", listener.local_addr()?);
    Ok(axum::serve(listener, service).await?)
}

use std::error::Error;
use std::path::Path;

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree};

use super::error::{PictureError, within};

/// Pixels per inch of a PNG: what journals ask of line art in colour.
pub const PNG_DOTS_PER_INCH: f32 = 300.0;

/// Pixels of a PNG at most: 400 MB in memory.
const PIXELS_MAX: f64 = 1e8;

/// Writes a picture to a file, `.svg` as it is, `.png` rasterised.
///
/// # Errors
/// [`PictureError`] where the name has another ending, or the file can't be written.
pub fn save(svg: &str, path: &Path) -> Result<(), PictureError> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    let bytes = match ending.as_deref() {
        Some("svg") => svg.as_bytes().to_vec(),
        Some("png") => png(svg)?,
        _ => return Err(PictureError::Format { path: path.to_owned() }),
    };
    std::fs::write(path, bytes).map_err(|source| PictureError::Write { path: path.to_owned(), source })
}

/// Rasterises a picture.
///
/// # Errors
/// [`PictureError`] where it is not well-formed or has more pixels than 10⁸.
pub fn png(svg: &str) -> Result<Vec<u8>, PictureError> {
    fn failed(error: impl Into<Box<dyn Error + Send + Sync>>) -> PictureError {
        PictureError::Raster(error.into())
    }
    let tree = Tree::from_str(svg, &Options::default()).map_err(failed)?;
    // CSS has 96 pixels to the inch.
    let scale = PNG_DOTS_PER_INCH / 96.0;
    let [width, height] =
        [tree.size().width(), tree.size().height()].map(|size| (size * scale).ceil() as u32);
    within("the number of pixels", f64::from(width) * f64::from(height), 1.0, PIXELS_MAX)?;
    let mut pixels = Pixmap::new(width, height).ok_or_else(|| failed("it has no size"))?;
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut pixels.as_mut());
    pixels.encode_png().map_err(failed)
}

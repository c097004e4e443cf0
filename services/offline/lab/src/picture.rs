//! Writes pictures to files: SVG unchanged, PNG rasterised.

use std::path::Path;

use console::failure::Failure;
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree};

/// Pixels per inch of a PNG, as journals require for line art in colour.
const DOTS_PER_INCH: f32 = 300.0;
/// Maximum number of pixels of a PNG: 400 MB in memory.
const PIXELS_MAX: f64 = 1e8;

/// Writes a picture to a file whose name ends in `.svg` or `.png`.
///
/// # Errors
/// [`Failure::Data`] if the name has another ending, the picture is too large, or the file can't be written.
pub fn save(svg: &str, path: &Path) -> Result<(), Failure> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    let bytes = match ending.as_deref() {
        Some("svg") => svg.as_bytes().to_vec(),
        Some("png") => png(svg).map_err(|why| Failure::file(path, why))?,
        _ => return Err(Failure::file(path, "pictures are written as .svg or .png")),
    };
    std::fs::write(path, bytes).map_err(|error| Failure::file(path, error))
}

/// Rasterises a picture.
fn png(svg: &str) -> Result<Vec<u8>, String> {
    let tree = Tree::from_str(svg, &Options::default()).map_err(|error| error.to_string())?;
    // CSS has 96 pixels per inch.
    let scale = DOTS_PER_INCH / 96.0;
    let [width, height] =
        [tree.size().width(), tree.size().height()].map(|size| (size * scale).ceil() as u32);
    let pixels = f64::from(width) * f64::from(height);
    let canvas = Pixmap::new(width, height).filter(|_| pixels <= PIXELS_MAX);
    let mut canvas = canvas.ok_or_else(|| format!("{width} × {height} pixels are too many"))?;
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut canvas.as_mut());
    canvas.encode_png().map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(side_pt: u32) -> String {
        format!("<svg xmlns='http://www.w3.org/2000/svg' width='{side_pt}pt' height='{side_pt}pt'/>")
    }

    #[test]
    fn a_png_has_300_dots_per_inch() {
        let png = png(&square(72)).unwrap();
        assert_eq!(&png[1..4], b"PNG");
        let pixels = [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().unwrap()));
        assert_eq!(pixels, [300; 2]);
    }

    #[test]
    fn what_is_no_picture_is_refused() {
        assert!(png("<svg").is_err());
        assert!(png(&square(7_200)).unwrap_err().contains("pixels are too many"));
        let refused = save(&square(72), Path::new("picture.gif")).unwrap_err().to_string();
        assert_eq!(refused, "picture.gif: pictures are written as .svg or .png");
    }
}

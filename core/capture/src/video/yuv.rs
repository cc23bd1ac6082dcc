//! From planar 4:2:0 to RGB, with the matrix and range the stream names.

use heartian_space::Rgb8Image;

/// Planes of an 8-bit 4:2:0 picture: chroma has half the width and height, rounded up or down to what the planes hold.
#[derive(Clone, Copy, Debug)]
pub(super) struct Planes<'a> {
    pub width: usize,
    pub height: usize,
    pub y: &'a [u8],
    pub u: &'a [u8],
    pub v: &'a [u8],
}

/// How numbers become light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Encoding {
    /// Matrix coefficients (ITU-T H.273).
    pub matrix: u8,
    /// Whether luma spans 0–255 rather than 16–235.
    pub full_range: bool,
}

/// Fixed-point factors, 16 fractional bits.
struct Factors {
    luma: i32,
    black: i32,
    red_v: i32,
    green_u: i32,
    green_v: i32,
    blue_u: i32,
}

impl Encoding {
    fn factors(self) -> Factors {
        // Unspecified colours are BT.601, as ffmpeg assumes.
        let (kr, kb) = match self.matrix {
            1 => (0.2126, 0.0722),
            4 => (0.30, 0.11),
            7 => (0.212, 0.087),
            9 | 10 => (0.2627, 0.0593),
            _ => (0.299, 0.114),
        };
        let kg = 1.0 - kr - kb;
        let (luma, chroma, black) = if self.full_range { (1.0, 1.0, 0) } else { (255.0 / 219.0, 255.0 / 224.0, 16) };
        let fixed = |value: f64| (value * 65536.0).round() as i32;
        Factors {
            luma: fixed(luma),
            black,
            red_v: fixed(2.0 * (1.0 - kr) * chroma),
            green_u: fixed(-2.0 * (1.0 - kb) * kb / kg * chroma),
            green_v: fixed(-2.0 * (1.0 - kr) * kr / kg * chroma),
            blue_u: fixed(2.0 * (1.0 - kb) * chroma),
        }
    }
}

/// Converts a picture. Chroma is interpolated linearly; its samples lie on even columns and between rows (MPEG-2 siting).
/// `None` when a plane is shorter than the size says.
pub(super) fn rgb_from_yuv(planes: &Planes<'_>, encoding: Encoding) -> Option<Rgb8Image> {
    let Planes { width, height, y, u, v } = *planes;
    let (half_width, half_height) = (width / 2, height / 2);
    if half_width == 0 || half_height == 0 || y.len() < width.checked_mul(height)? {
        return None;
    }
    if u.len() < half_width * half_height || v.len() < half_width * half_height {
        return None;
    }
    let factors = encoding.factors();
    let mut data = Vec::with_capacity(width * height * 3);
    let (mut u_row, mut v_row) = (vec![0i32; width], vec![0i32; width]);
    for row in 0..height {
        chroma_row(u, [half_width, half_height], row, &mut u_row);
        chroma_row(v, [half_width, half_height], row, &mut v_row);
        for ((luma, u), v) in y[row * width..(row + 1) * width].iter().zip(&u_row).zip(&v_row) {
            data.extend(factors.rgb(i32::from(*luma), *u, *v));
        }
    }
    Some(Rgb8Image { width, height, data })
}

impl Factors {
    /// Chroma in eighths, offset included.
    #[inline(always)]
    fn rgb(&self, luma: i32, u: i32, v: i32) -> [u8; 3] {
        let (y, u, v) = ((luma - self.black) * self.luma, u - 1024, v - 1024);
        let channel = |chroma: i32| ((y + ((chroma + 4) >> 3) + 32768) >> 16).clamp(0, 255) as u8;
        [channel(self.red_v * v), channel(self.green_u * u + self.green_v * v), channel(self.blue_u * u)]
    }
}

/// One luma row's chroma, in eighths.
fn chroma_row(plane: &[u8], [width, height]: [usize; 2], row: usize, out: &mut [i32]) {
    let near = (row / 2).min(height - 1);
    let far = if row.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(height - 1) };
    let (near, far) = (&plane[near * width..][..width], &plane[far * width..][..width]);
    let at = |i: usize| 3 * i32::from(near[i]) + i32::from(far[i]);
    for (x, out) in out.iter_mut().enumerate() {
        let left = (x / 2).min(width - 1);
        *out = if x % 2 == 0 { 2 * at(left) } else { at(left) + at((left + 1).min(width - 1)) };
    }
}

/// Turns a picture clockwise by quarter turns.
pub(super) fn turned(image: Rgb8Image, quarter_turns: u8) -> Rgb8Image {
    let (w, h) = (image.width, image.height);
    let (width, height) = if quarter_turns % 2 == 1 { (h, w) } else { (w, h) };
    if quarter_turns.is_multiple_of(4) {
        return image;
    }
    let mut out = Rgb8Image::filled(width, height, [0; 3]);
    for y in 0..height {
        for x in 0..width {
            let (sx, sy) = match quarter_turns % 4 {
                1 => (y, h - 1 - x),
                2 => (w - 1 - x, h - 1 - y),
                _ => (w - 1 - y, x),
            };
            out.set_pixel(x, y, image.pixel(sx, sy));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(y: u8, u: u8, v: u8, encoding: Encoding) -> Option<[u8; 3]> {
        let planes = Planes { width: 4, height: 4, y: &[y; 16], u: &[u; 4], v: &[v; 4] };
        rgb_from_yuv(&planes, encoding).map(|image| image.pixel(2, 1))
    }

    #[test]
    fn reference_colours_come_out() {
        let limited = Encoding { matrix: 2, full_range: false };
        assert_eq!(flat(16, 128, 128, limited), Some([0, 0, 0]));
        assert_eq!(flat(235, 128, 128, limited), Some([255, 255, 255]));
        // BT.601 red is (81, 90, 240), BT.709 red is (63, 102, 240).
        assert_eq!(flat(81, 90, 240, limited), Some([254, 0, 0]));
        let red = flat(63, 102, 240, Encoding { matrix: 1, full_range: false });
        assert!(red.is_some_and(|[r, g, b]| r >= 254 && g <= 1 && b <= 1), "{red:?}");
        assert_eq!(flat(77, 128, 128, Encoding { matrix: 6, full_range: true }), Some([77; 3]));
        assert!(rgb_from_yuv(&Planes { width: 4, height: 4, y: &[0; 15], u: &[0; 4], v: &[0; 4] }, limited).is_none());
    }

    #[test]
    fn a_chroma_ramp_stays_a_ramp() {
        let u: Vec<u8> = (0..8).flat_map(|_| (0..8).map(|x| 100 + 4 * x)).collect();
        let mut row = vec![0; 16];
        chroma_row(&u, [8, 8], 5, &mut row);
        assert!(row[..15].windows(2).all(|pair| pair[1] - pair[0] == 16), "{row:?}");
    }

    #[test]
    fn four_quarter_turns_are_none_and_one_is_clockwise() {
        let image = Rgb8Image { width: 2, height: 1, data: vec![1, 1, 1, 2, 2, 2] };
        let once = turned(image.clone(), 1);
        assert_eq!((once.width, once.height, once.pixel(0, 0)[0], once.pixel(0, 1)[0]), (1, 2, 1, 2));
        let all = (0..4).fold(image.clone(), |image, _| turned(image, 1));
        assert_eq!(all, image);
        assert_eq!(turned(turned(image.clone(), 3), 1), image);
    }
}

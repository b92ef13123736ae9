//! OBJ, written while the mesh is made.
//!
//! Lines have a fixed width, filled with spaces, so that the place of each is known. A coordinate
//! has the fewest digits that give the same f32 again. A vertex is a `v` line and, with normals, a
//! `vn` line; a face is `f a b c` or `f a//a b//b c//c`, numbered from 1 in 64 bits.

use crate::mesh_stream::{Encode, Shape};
use brickmarch::mesh::{Layout, Piece, Totals};
use brickmarch::{Error, ErrorKind, Result};
use std::io::Write;
use std::ops::Range;

/// Characters of a coordinate: sign, point, nine digits and either three zeros or an exponent.
const NUMBER: usize = 15;

/// Digits of a vertex number; 10^12 lines are 50 TB of text.
const INDEX: usize = 12;

const MOST_VERTICES: u64 = 10_u64.pow(INDEX as u32) - 1;

/// "v", a space before each of three numbers, the end of the line.
const VERTEX_BYTES: usize = 1 + 3 * (1 + NUMBER) + 1;
/// The same with "vn".
const NORMAL_BYTES: usize = 1 + VERTEX_BYTES;
const FACE_BYTES: usize = 1 + 3 * (1 + INDEX) + 1;
const FACE_WITH_NORMALS_BYTES: usize = 1 + 3 * (1 + INDEX + 2 + INDEX) + 1;

const HEADER: &str = "# brickmarch\n";

/// Encoder of OBJ.
#[derive(Debug, Default)]
pub(crate) struct Obj {
    normals: bool,
}

impl Encode for Obj {
    fn capacity(&self) -> Totals {
        Totals {
            vertices: MOST_VERTICES,
            triangles: u64::MAX,
        }
    }

    fn begin(&mut self, layout: Layout) -> Result<Shape> {
        if layout.keys {
            return Err(Error::new(
                ErrorKind::Unsupported,
                "OBJ holds no keys: leave them out, or write PLY",
            ));
        }
        self.normals = layout.normals;
        Ok(Shape {
            header: HEADER.len() as u64,
            vertex: VERTEX_BYTES + if self.normals { NORMAL_BYTES } else { 0 },
            triangle: if self.normals {
                FACE_WITH_NORMALS_BYTES
            } else {
                FACE_BYTES
            },
        })
    }

    fn vertices(&self, piece: &Piece, range: Range<usize>, out: &mut [u8]) {
        let own = &piece.own[range];
        let size = out.len() / own.len().max(1);
        for (&local, record) in own.iter().zip(out.chunks_exact_mut(size.max(1))) {
            let (vertex, normal) = record.split_at_mut(VERTEX_BYTES);
            put_line(vertex, b"v", piece.positions[local as usize]);
            if self.normals {
                put_line(normal, b"vn", piece.normals[local as usize]);
            }
        }
    }

    fn triangles(&self, piece: &Piece, range: Range<usize>, out: &mut [u8]) {
        let triangles = &piece.triangles[range];
        let size = out.len() / triangles.len().max(1);
        for (corners, record) in triangles.iter().zip(out.chunks_exact_mut(size.max(1))) {
            record.fill(b' ');
            record[0] = b'f';
            record[size - 1] = b'\n';
            for (field, &v) in record[1..size - 1]
                .chunks_exact_mut((size - 2) / 3)
                .zip(corners)
            {
                let number = piece.ids[v as usize] + 1;
                let mut digits = [0; INDEX];
                let digits = decimal(number, &mut digits);
                field[1..1 + digits.len()].copy_from_slice(digits);
                if self.normals {
                    let second = 1 + digits.len() + 2;
                    field[second - 2..second].copy_from_slice(b"//");
                    field[second..second + digits.len()].copy_from_slice(digits);
                }
            }
        }
    }

    fn header(&self, _totals: Totals) -> Vec<u8> {
        HEADER.as_bytes().to_vec()
    }
}

/// Decimal digits of `number`, which has at most `INDEX` of them.
fn decimal(mut number: u64, digits: &mut [u8; INDEX]) -> &[u8] {
    let mut at = INDEX;
    loop {
        at -= 1;
        digits[at] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            return &digits[at..];
        }
    }
}

fn put_line(line: &mut [u8], word: &[u8], values: [f32; 3]) {
    line[..word.len()].copy_from_slice(word);
    let (fields, end) = line[word.len()..].split_at_mut(3 * (1 + NUMBER));
    end[0] = b'\n';
    for (field, value) in fields.chunks_exact_mut(1 + NUMBER).zip(values) {
        field[0] = b' ';
        put_number(&mut field[1..], value);
    }
}

/// The shortest text that reads as `value` again, then spaces.
fn put_number(mut field: &mut [u8], value: f32) {
    let size = value.abs();
    let written = if size == 0.0 || (1e-4..1e9).contains(&size) || !size.is_finite() {
        write!(field, "{value}")
    } else {
        write!(field, "{value:e}")
    };
    written.expect("nine digits, sign, point and exponent fit");
    field.fill(b' ');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_fit_their_field_and_read_back() {
        let special = [
            0.0,
            -0.0,
            f32::MIN_POSITIVE,
            -f32::MAX,
            f32::from_bits(1),
            -1e-4,
            -1.000_000_1e-4,
            999_999_940.0,
            f32::NEG_INFINITY,
        ];
        // Every exponent and sign with mantissas that need all digits.
        let spread = (0..=u32::MAX >> 16).map(|high| f32::from_bits(high << 16 | 0x9e3b));
        for value in special.into_iter().chain(spread) {
            let mut field = [0; NUMBER];
            put_number(&mut field, value);
            let text = std::str::from_utf8(&field).expect("ascii");
            let back: f32 = text.trim_end().parse().expect("a number");
            assert!(
                back.to_bits() == value.to_bits() || (back.is_nan() && value.is_nan()),
                "{value:e} became {text:?}"
            );
        }
    }

    #[test]
    fn decimal_of_every_length() {
        let mut digits = [0; INDEX];
        assert_eq!(decimal(0, &mut digits), b"0");
        assert_eq!(decimal(120, &mut digits), b"120");
        assert_eq!(decimal(MOST_VERTICES, &mut digits), [b'9'; INDEX]);
    }
}

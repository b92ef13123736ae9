//! Tests that hold for the readers of all mesh formats, and the oddities of each.

use crate::{Loaded, create_mesh_sink, read_mesh};
use brickmarch::mesh::{self, EdgeKey, check, feed};
use brickmarch::{Budget, Error, ErrorKind, Mesh, Result};
use std::path::Path;

fn read(name: &str, bytes: &[u8]) -> Result<Loaded> {
    read_under(name, bytes, &Budget::mib(16).with_threads(1))
}

fn read_under(name: &str, bytes: &[u8], budget: &Budget) -> Result<Loaded> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("writes");
    read_mesh(&path, budget)
}

fn refused(name: &str, bytes: &[u8]) -> Error {
    match read(name, bytes) {
        Ok(mesh) => panic!("{name} was read: {mesh:?}"),
        Err(error) => {
            let text = error.to_string();
            assert!(text.contains(name) && !text.contains('\n'), "{text}");
            error
        }
    }
}

fn written(name: &str, mesh: &Mesh) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join(name);
    let mut sink = create_mesh_sink(&path, false).expect("made");
    feed(mesh, &mut *sink, 5).expect("fed");
    std::fs::read(&path).expect("reads")
}

/// An octahedron with awkward coordinates and a vertex that nothing uses.
fn octahedron(normals: bool, keys: bool) -> Mesh {
    let mut mesh = Mesh {
        positions: vec![
            [1.0, 0.1, 1e-30],
            [-1.0, -1e-5, 0.0],
            [0.0, 1.000_000_1, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, 123_456.79],
            [0.0, 0.0, -7.0e20],
            [5.0, 5.0, 5.0],
        ],
        triangles: vec![
            [0, 2, 4],
            [2, 1, 4],
            [1, 3, 4],
            [3, 0, 4],
            [2, 0, 5],
            [1, 2, 5],
            [3, 1, 5],
            [0, 3, 5],
        ],
        ..Mesh::default()
    };
    if normals {
        mesh.normals = mesh.positions.iter().map(|p| [p[1], 0.25, -1.0]).collect();
    }
    if keys {
        mesh.keys = (0..mesh.positions.len() as i32)
            .map(|i| EdgeKey {
                point: [i, -i * 1_000_000, i32::MIN + i],
                axis: (i % 4) as u8,
            })
            .collect();
    }
    mesh
}

/// The same octahedron in other dialects of PLY.
fn ply(format: &str, index: &str, faces: &[&[u8]]) -> Vec<u8> {
    let mesh = octahedron(false, false);
    let mut bytes = format!(
        "ply\r\nformat {format} 1.0\ncomment caf\u{e9}\nelement vertex {}\nproperty double y\nproperty uchar red\n\
         property float x\nproperty float z\nelement face {}\nproperty list {index} vertex_index\nproperty short group\nend_header\n",
        mesh.positions.len(),
        faces.len()
    )
    .into_bytes();
    let big = format == "binary_big_endian";
    let text = format == "ascii";
    let mut put = |value: f64, kind: &str, last: &str| {
        if text {
            let end = if kind == last { '\n' } else { ' ' };
            bytes.extend(format!("{value}{end}").bytes());
            return;
        }
        let mut raw = match kind {
            "double" => value.to_le_bytes().to_vec(),
            "float" => (value as f32).to_le_bytes().to_vec(),
            "uchar" => vec![value as u8],
            "short" => (value as i16).to_le_bytes().to_vec(),
            _ => (value as i32).to_le_bytes().to_vec(),
        };
        if big {
            raw.reverse();
        }
        bytes.extend(raw);
    };
    for [x, y, z] in mesh.positions.iter().map(|p| p.map(f64::from)) {
        put(y, "double", "");
        put(200.0, "uchar", "");
        put(x, "float", "");
        put(z, "float", "float");
    }
    let (count, entry) = index.split_once(' ').expect("two types");
    for face in faces {
        put(face.len() as f64, count, "");
        for &corner in *face {
            put(corner.into(), entry, "");
        }
        put(-3.0, "short", "short");
    }
    bytes
}

const FACES: [&[u8]; 8] = [
    &[0, 2, 4],
    &[2, 1, 4],
    &[1, 3, 4],
    &[3, 0, 4],
    &[2, 0, 5],
    &[1, 2, 5],
    &[3, 1, 5],
    &[0, 3, 5],
];

const TEXT_STL: &str = "solid  a\r\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n\
    vertex 0 1 -0\nendloop\nendfacet\nendsolid a\n\nSOLID b\n FACET NORMAL 0 0 1\n  OUTER LOOP\n   VERTEX 1 0 0\n   \
    VERTEX 1 1 0\n   VERTEX 0 1 0\n  ENDLOOP\n ENDFACET\nENDSOLID b\n";

const TEXT_OBJ: &str = "# C:\\models\\\nmtllib none.mtl\no first\nv 0 0 0 0.5 0.5 nan\nv 2 0 0 2\nv 1 1 \\\n0\n\
    vt 0 0\nvn 0 0 1\ng one\nusemtl red\nf 1/1/1 2//1 3\nl 1 2\nv 0 1 0\nv 9 9 9\no second\nf -5 -3 -2\n";

#[test]
fn meshes_round_trip() {
    for (normals, keys) in [(false, false), (true, false), (false, true), (true, true)] {
        let mesh = octahedron(normals, keys);
        let back = read("a.ply", &written("a.ply", &mesh)).expect("reads");
        assert_eq!(*back, mesh, "normals {normals}, keys {keys}");
    }
    let mesh = octahedron(false, false);
    assert_eq!(
        *read("a.obj", &written("a.obj", &mesh)).expect("reads"),
        mesh
    );
    let with_normals = octahedron(true, false);
    let text = written("a.obj", &with_normals);
    assert_eq!(*read("a.obj", &text).expect("reads"), mesh);
    let text = String::from_utf8(text).expect("text");
    assert_eq!(text.lines().filter(|l| l.starts_with("vn ")).count(), 7);
    assert!(text.contains("f 1//1 "), "{text}");

    let back = read("a.stl", &written("a.stl", &mesh)).expect("reads");
    let corners = |mesh: &Mesh| -> Vec<[[f32; 3]; 3]> {
        let place = |v| mesh.positions[v as usize];
        mesh.triangles.iter().map(|t| t.map(place)).collect()
    };
    assert_eq!(corners(&back), corners(&mesh));
    assert_eq!(back.positions.len(), 6, "the unused vertex is not in STL");
    assert!(check(&back, &Budget::mib(1)).expect("checked").closed);
}

#[test]
fn empty_meshes_round_trip() {
    for name in ["a.ply", "a.stl", "a.obj"] {
        let back = read(name, &written(name, &Mesh::default())).expect("reads");
        assert_eq!(*back, Mesh::default(), "{name}");
    }
    let back = read("a.stl", b"solid nothing\nendsolid nothing").expect("reads");
    assert_eq!(*back, Mesh::default());
}

#[test]
fn numbers_of_several_blocks_round_trip() {
    let n = 400_000_u32;
    let mesh = Mesh {
        positions: (0..n).map(|i| [i as f32, 0.5, -(i as f32)]).collect(),
        triangles: (0..n - 2).map(|i| [i, i + 1, i + 2]).collect(),
        ..Mesh::default()
    };
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.ply");
    let mut sink = create_mesh_sink(&path, false).expect("made");
    feed(&mesh, &mut *sink, 100_000).expect("fed");
    let budget = Budget::mib(32);
    let back = read_mesh(&path, &budget).expect("reads");
    assert!(*back == mesh);
    assert_eq!(budget.used_bytes(), 12 * u64::from(2 * n - 2));
    let (_, permit) = back.into_parts();
    drop(permit);
    assert_eq!(budget.used_bytes(), 0);
}

#[test]
fn every_dialect_of_ply_reads_the_same() {
    let mesh = octahedron(false, false);
    for format in ["binary_little_endian", "binary_big_endian", "ascii"] {
        for index in ["uchar int", "uchar uchar", "int short"] {
            let back = read("a.ply", &ply(format, index, &FACES)).expect("reads");
            assert_eq!(*back, mesh, "{format}, {index}");
        }
        // A pyramid over a square, its base last.
        let polygons: [&[u8]; 2] = [&[0, 2, 4], &[3, 1, 2, 0]];
        let back = read("a.ply", &ply(format, "uchar int", &polygons)).expect("reads");
        assert_eq!(back.triangles, [[0, 2, 4], [3, 1, 2], [3, 2, 0]]);
        let error = refused("a.ply", &ply(format, "uchar int", &[&[0, 2]]));
        assert!(error.to_string().contains("face 0"), "{error}");
        let error = refused(
            "a.ply",
            &ply(format, "uchar int", &[&[0, 1, 2], &[0, 2, 7]]),
        );
        assert!(
            error.to_string().contains("face 1 names vertex 7 of 7"),
            "{error}"
        );
    }
}

#[test]
fn a_plain_ply_with_one_polygon_reads_too() {
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
        .to_vec();
    for v in 0..12 {
        bytes.extend((v as f32).to_le_bytes());
    }
    for face in [&[0, 1, 2][..], &[3, 2, 1, 0]] {
        bytes.push(face.len() as u8);
        face.iter()
            .for_each(|v: &i32| bytes.extend(v.to_le_bytes()));
    }
    let back = read("a.ply", &bytes).expect("reads");
    assert_eq!(back.triangles, [[0, 1, 2], [3, 2, 1], [3, 1, 0]]);
    assert_eq!(back.positions.len(), 4);
    let at = bytes.len() - 4;
    bytes[at..].copy_from_slice(&(-1_i32).to_le_bytes());
    assert_eq!(refused("a.ply", &bytes).kind(), ErrorKind::Damaged);
}

#[test]
fn what_is_no_mesh_is_refused() {
    let points = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
    assert_eq!(refused("a.ply", points).kind(), ErrorKind::Unsupported);
    for bytes in [
        &b""[..],
        b"ply",
        b"ply\n",
        b"solid",
        b"ply\nend_header\n",
        &[0; 200],
    ] {
        refused("a.ply", bytes);
        if bytes != b"solid" {
            refused("a.stl", bytes);
        }
    }
    assert_eq!(refused("a.xyz", b"0 0 0").kind(), ErrorKind::Unsupported);
    let budget = Budget::mib(1);
    let missing = read_mesh(Path::new("/nowhere/a.ply"), &budget).expect_err("missing");
    assert_eq!(missing.kind(), ErrorKind::Io);
    let folder = tempfile::tempdir().expect("folder");
    let inner = folder.path().join("a.ply");
    std::fs::create_dir(&inner).expect("made");
    assert!(read_mesh(&inner, &budget).is_err(), "a folder");
}

#[test]
fn text_stl_of_several_solids() {
    let mesh = read("a.stl", TEXT_STL.as_bytes()).expect("reads");
    assert_eq!(mesh.triangles, [[0, 1, 2], [1, 3, 2]]);
    assert_eq!(mesh.positions[2], [0.0, 1.0, 0.0]);
    assert!(mesh.positions[2][2].is_sign_positive());
}

#[test]
fn a_binary_stl_may_be_called_solid() {
    let mesh = octahedron(false, false);
    let mut bytes = written("a.stl", &mesh);
    assert!(!bytes.starts_with(b"solid"));
    bytes[..12].copy_from_slice(b"solid\nfacet ");
    assert_eq!(read("a.stl", &bytes).expect("reads").triangles.len(), 8);
    bytes[84 + 12..84 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    let back = read("a.stl", &bytes).expect("reads");
    let report = check(&back, &Budget::mib(1)).expect("checked");
    assert_eq!(report.nonfinite_vertices, 1);
}

#[test]
fn obj_with_everything_around_the_mesh() {
    let mesh = read("a.obj", TEXT_OBJ.as_bytes()).expect("reads");
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    // The second has weight 2; the last is not used.
    assert_eq!(mesh.positions[1], [1.0, 0.0, 0.0]);
    assert_eq!(mesh.positions[2], [1.0, 1.0, 0.0]);
    assert_eq!(mesh.positions[4], [9.0; 3]);
}

#[test]
fn every_number_of_obj_vertices_keeps_its_order() {
    for n in (0..200).chain([1000, 4095, 4096]) {
        let rich = if n % 2 == 0 { "" } else { "g rich\n" };
        let mesh = Mesh {
            positions: (0..n).map(|i| [i as f32, 0.0, 1.0]).collect(),
            triangles: if n > 2 {
                vec![[n - 1, 0, n / 2]; 2]
            } else {
                Vec::new()
            },
            ..Mesh::default()
        };
        let mut text = written("a.obj", &mesh);
        text.extend(rich.bytes());
        let back = read("a.obj", &text).expect("reads");
        assert_eq!(*back, mesh, "{n} vertices");
    }
}

#[test]
fn plain_and_rich_obj_are_the_same_mesh() {
    let mesh = octahedron(true, false);
    let plain = written("a.obj", &mesh);
    let mut rich = plain.clone();
    rich.extend(b"g more\n");
    let (small, large) = (Budget::mib(16), Budget::mib(16));
    let first = read_under("a.obj", &plain, &small).expect("reads");
    let second = read_under("a.obj", &rich, &large).expect("reads");
    assert_eq!(*first, *second);
    assert!(small.peak_bytes() < large.peak_bytes());
    // Numbers from the end, as a plain file may have them too.
    let text = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1\nf -4 -2/7 -1//1\n";
    let back = read("a.obj", text).expect("reads");
    assert_eq!(back.triangles, [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn obj_errors_name_the_line() {
    for (text, line) in [
        ("v 0 0\n", "line 1"),
        ("v 0 0 x\n", "line 1"),
        ("v 0 0 x 1 1 1\n", "line 1"),
        ("v 0 0 0\nf 1 1 2\n", "line 2"),
        ("v 0 0 0\nf 1 1 1 2\n", "line 2"),
        ("v 0 0 0 0\n", "line 1"),
        ("v 0 0 0\nv 1 0 \\\n0\nf 1 2 3\n", "line 4"),
        ("v 0 0 0\nf 1 1 0\n", "line 2"),
        ("v 0 0 0\nf -2 1 1\n", "line 2"),
        ("v 0 0 0\nf 1 1\n", "line 2"),
        ("v 0 0 0\nf a b c\n", "line 2"),
        ("v 0 0 0\nf 1 1 -9223372036854775808\n", "line 2"),
    ] {
        let error = refused("a.obj", text.as_bytes());
        assert_eq!(error.kind(), ErrorKind::Damaged);
        assert!(error.to_string().contains(line), "{error}");
    }
    let endless = vec![b'v'; 2 << 20];
    assert!(refused("a.obj", &endless).to_string().contains("1 MiB"));
}

#[test]
fn every_truncation_is_an_error() {
    let mesh = octahedron(true, true);
    let bare = octahedron(false, false);
    let polygons: [&[u8]; 2] = [&[0, 2, 4, 1], &[3, 1, 2, 0, 5]];
    for (name, bytes, certain) in [
        ("a.ply", written("a.ply", &mesh), usize::MAX),
        ("a.ply", written("a.ply", &bare), usize::MAX),
        (
            "a.ply",
            ply("binary_little_endian", "uchar int", &polygons),
            usize::MAX,
        ),
        (
            "a.ply",
            ply("binary_big_endian", "int int", &polygons),
            usize::MAX,
        ),
        // The last number of a text may lose digits, or only the space behind it.
        ("a.ply", ply("ascii", "uchar int", &polygons), 2),
        ("a.stl", written("a.stl", &bare), usize::MAX),
        ("a.stl", TEXT_STL.into(), 3),
    ] {
        read(name, &bytes).expect("the whole is good");
        for n in 0..bytes.len() {
            let result = read(name, &bytes[..n]);
            let near_end = certain != usize::MAX && n + certain >= bytes.len();
            // A text of two solids is whole after the first.
            let end = bytes[..n].trim_ascii_end();
            let whole = name == "a.stl"
                && [&b"endsolid a"[..], b"endsolid"]
                    .iter()
                    .any(|e| end.ends_with(e));
            assert!(
                result.is_err() || near_end || whole,
                "{name}: {n} of {} bytes pass",
                bytes.len()
            );
        }
    }
    // OBJ has no counts; a part of it is often a mesh, but never a panic.
    for n in 0..TEXT_OBJ.len() {
        let _ = read("a.obj", &TEXT_OBJ.as_bytes()[..n]);
    }
}

#[test]
fn every_bit_flip_is_an_error_or_a_mesh() {
    let bare = octahedron(false, false);
    let folder = tempfile::tempdir().expect("folder");
    for (name, bytes) in [
        ("a.ply", written("a.ply", &octahedron(true, true))),
        ("a.ply", ply("binary_big_endian", "int int", &FACES[..3])),
        ("a.ply", ply("ascii", "uchar int", &FACES[..3])),
        ("a.stl", written("a.stl", &bare)),
        ("a.stl", TEXT_STL.into()),
        ("a.obj", TEXT_OBJ.into()),
    ] {
        let path = folder.path().join(name);
        for bit in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            std::fs::write(&path, &flipped).expect("writes");
            let budget = Budget::mib(8).with_threads(1);
            if let Ok(mesh) = read_mesh(&path, &budget) {
                check(&mesh, &budget).expect("every corner is a vertex");
                let held = (mesh.positions.len() + mesh.triangles.len()) as u64;
                assert!(held <= bytes.len() as u64, "{name}: bit {bit}");
            }
            assert_eq!(budget.used_bytes(), 0);
        }
    }
}

#[test]
fn huge_declared_counts_are_refused_before_memory_is_taken() {
    let header = |vertices: &str, faces: &str, format: &str, more: &str| {
        format!(
            "ply\nformat {format} 1.0\n{more}element vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {faces}\nproperty list uint int vertex_indices\nend_header\n1 2 3\n"
        )
    };
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for (vertices, faces, more) in [
            ("4294967295", "0", ""),
            ("18446744073709551615", "0", ""),
            ("0", "18446744073709551615", ""),
            ("99999999999999999999999", "0", ""),
            ("0", "0", "element nothing 18446744073709551615\n"),
            (
                "0",
                "0",
                "element nothing 18446744073709551615\nproperty list uchar int x\n",
            ),
        ] {
            let budget = Budget::mib(16);
            let text = header(vertices, faces, format, more);
            let error = read_under("a.ply", text.as_bytes(), &budget).expect_err("too many");
            assert!(
                matches!(error.kind(), ErrorKind::Truncated | ErrorKind::Damaged),
                "{error}"
            );
            assert_eq!(budget.peak_bytes(), 0, "{error}");
        }
    }
    // One face that says it has four billion corners.
    let mut bytes = header("0", "1", "binary_little_endian", "").into_bytes();
    bytes.truncate(bytes.len() - 6);
    bytes.extend([0xff; 64]);
    assert_eq!(refused("a.ply", &bytes).kind(), ErrorKind::Truncated);

    let mut bytes = written("a.stl", &octahedron(false, false));
    bytes[80..84].fill(0xff);
    let budget = Budget::mib(16);
    let error = read_under("a.stl", &bytes, &budget).expect_err("too many");
    assert_eq!(error.kind(), ErrorKind::Truncated);
    assert_eq!(budget.peak_bytes(), 0);
}

#[test]
fn a_small_budget_is_an_error_that_says_so() {
    let mesh = octahedron(false, false);
    for name in ["a.ply", "a.stl", "a.obj"] {
        let budget = Budget::bytes(100);
        let error = read_under(name, &written(name, &mesh), &budget).expect_err("too little");
        assert_eq!(error.kind(), ErrorKind::BudgetExceeded, "{error}");
        assert!(error.to_string().contains(name), "{error}");
        assert_eq!(budget.used_bytes(), 0);
    }
    // Text has no count to go by: the list of corners hits the limit while it grows.
    let facet = TEXT_STL
        .lines()
        .skip(1)
        .take(7)
        .collect::<Vec<_>>()
        .join("\n");
    let text = format!(
        "solid x\n{}endsolid x\n",
        format!("{facet}\n").repeat(20_000)
    );
    let budget = Budget::mib(1);
    let error = read_under("a.stl", text.as_bytes(), &budget).expect_err("too little");
    assert_eq!(error.kind(), ErrorKind::BudgetExceeded, "{error}");
    assert!(budget.peak_bytes() > 1 << 17, "it began");
}

/// Vertices, triangles, border edges, crowded edges, euler, components of files from elsewhere,
/// found by an independent program.
#[test]
fn meshes_from_elsewhere_give_the_known_counts() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let data = std::env::var_os("BRICKMARCH_DATA").map_or(workspace, Into::into);
    let meshes = data.join("meshes");
    #[expect(clippy::print_stderr, reason = "a skipped test says so")]
    if !meshes.is_dir() {
        eprintln!(
            "SKIPPED: no meshes in {}; set BRICKMARCH_DATA",
            data.display()
        );
        return;
    }
    for (name, expected) in [
        ("bob_small.ply", [250, 500, 0, 0, 0, 1]),
        ("spot.ply", [2930, 5856, 0, 0, 2, 1]),
        ("suzanne.ply", [1966, 968, 1966, 0, 499, 499]),
        ("fan3.obj", [5, 3, 6, 1, 1, 1]),
        ("moebius.obj", [280, 448, 112, 0, 0, 1]),
        ("negative_indices.obj", [8, 12, 0, 0, 2, 1]),
        ("wallhole.obj", [92, 66, 92, 0, 13, 13]),
        ("multibody.stl", [20, 32, 0, 0, 4, 2]),
        ("pig.stl", [8642, 16848, 1296, 0, -430, 1]),
        ("octagonal_pocket.stl", [1658, 3262, 54, 0, 0, 2]),
        ("featuretype.STL", [2010, 3476, 576, 0, -16, 1]),
        ("triple_vierbein.obj", [75, 108, 60, 20, 1, 1]),
        ("cycloidal.ply", [21384, 43368, 0, 242, -58, 100]),
        ("empty.stl", [0; 6]),
    ] {
        let budget = Budget::mib(64);
        let mesh = read_mesh(&meshes.join(name), &budget).expect(name);
        let r = mesh::check(&mesh, &budget).expect(name);
        let found = [
            r.vertices as i64,
            r.triangles as i64,
            r.border_edges as i64,
            r.nonmanifold_edges as i64,
            r.euler,
            r.components as i64,
        ];
        assert_eq!(found, expected, "{name}");
    }
}

/// A file in place gives what a file in memory gives, whatever else its records hold.
#[test]
fn in_place_is_as_in_memory() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("x.ply");
    let budget = brickmarch::Budget::mib(64);
    // Vertices with a double in front and positions in another order; faces with a label behind.
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 70000\nproperty double t\n\
        property float z\nproperty float x\nproperty float y\nelement face 70001\n\
        property list uchar uint vertex_indices\nproperty uint label\nproperty uchar more\nend_header\n"
        .to_vec();
    for i in 0..70_000_u32 {
        bytes.extend(1.5_f64.to_le_bytes());
        for v in [i as f32, 0.5, -(i as f32)] {
            bytes.extend(v.to_le_bytes());
        }
    }
    for i in 0..70_001_u32 {
        bytes.push(3);
        for v in [i, i + 7, i * 31] {
            bytes.extend((v % 70_000).to_le_bytes());
        }
        bytes.extend(i.to_le_bytes());
        bytes.push(9);
    }
    std::fs::write(&path, &bytes).expect("written");
    let whole = crate::read_mesh(&path, &budget).expect("read");
    let parts = crate::mesh_in_place(&path, &budget)
        .expect("read")
        .expect("the usual layout");
    assert_eq!((parts.vertices(), parts.triangles()), (70_000, 70_001));
    for (first, count) in [(0, 70_000), (69_999, 1), (123, 40_000), (5, 0)] {
        let mut positions = vec![[0.0; 3]; count];
        parts.read_positions(first, &mut positions).expect("read");
        assert_eq!(positions, whole.positions[first as usize..][..count]);
        let mut triangles = vec![[0; 3]; count];
        parts.read_triangles(first, &mut triangles).expect("read");
        assert_eq!(triangles, whole.triangles[first as usize..][..count]);
    }
    // A face of four corners is said when it is met.
    let record = 13 + 5;
    let at = bytes.len() - 10 * record;
    bytes[at] = 4;
    std::fs::write(&path, &bytes).expect("written");
    let parts = crate::mesh_in_place(&path, &budget)
        .expect("read")
        .expect("the usual layout");
    let error = parts
        .read_triangles(69_000, &mut vec![[0; 3]; 1001])
        .expect_err("a square");
    assert!(
        error.to_string().contains("face 69991 has 4 corners"),
        "{error}"
    );
    // What is shorter than it promises, and other layouts, are left to the reader of whole files.
    std::fs::write(&path, &bytes[..bytes.len() - 1]).expect("written");
    assert!(
        crate::mesh_in_place(&path, &budget)
            .expect("a header")
            .is_none()
    );
    std::fs::write(
        &path,
        "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n\
        property float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n",
    )
    .expect("written");
    assert!(
        crate::mesh_in_place(&path, &budget)
            .expect("a header")
            .is_none()
    );
}

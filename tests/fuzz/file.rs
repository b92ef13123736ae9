//! Importers and mesh readers take paths: one scratch file per process, best in memory (TMPDIR).

use brickmarch::Budget;
use brickmarch_formats::{OpenOptions, open_volume, read_mesh};
use std::io::Read;
use std::path::PathBuf;
use std::sync::OnceLock;
use tempfile::TempDir;

fn write(extension: &str, data: &[u8]) -> PathBuf {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| tempfile::tempdir().expect("a scratch folder"));
    let path = folder.path().join(format!("input.{extension}"));
    std::fs::write(&path, data).expect("scratch is writable");
    path
}

/// Opens as a volume and reads all samples. An accepted header must give exactly its samples, or a
/// read error.
#[allow(dead_code)]
pub fn import(extension: &str, data: &[u8], options: &OpenOptions) {
    let path = write(extension, data);
    let Ok(mut source) = open_volume(&path, options) else {
        return;
    };
    let wanted = source.grid.domain.count() as u128 * source.sample.bytes() as u128;
    // Smaller bricks may be too many for the format, which the writer says.
    source
        .spec(64)
        .validate()
        .expect("a source makes a good volume");
    let (mut total, mut buffer) = (0u128, vec![0; 64 << 10]);
    loop {
        match source.reader.read(&mut buffer) {
            Ok(0) => {
                assert_eq!(total, wanted, "the reader ended early without an error");
                break;
            }
            Ok(n) => total += n as u128,
            Err(_) => break,
        }
        // A gzip bomb within its declared size is no finding; time is.
        if total > 8 << 20 {
            break;
        }
        assert!(total <= wanted);
    }
    let _ = source.late_notes();
}

/// Reads as a mesh.
#[allow(dead_code)]
pub fn mesh(extension: &str, data: &[u8]) {
    let path = write(extension, data);
    let budget = Budget::mib(32).with_threads(1);
    if let Ok(loaded) = read_mesh(&path, &budget) {
        let (mesh, permit) = loaded.into_parts();
        let vertices = mesh.positions.len();
        assert!(
            mesh.triangles
                .iter()
                .flatten()
                .all(|&v| (v as usize) < vertices)
        );
        drop(permit);
    }
    assert_eq!(budget.used_bytes(), 0);
}

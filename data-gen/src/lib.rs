//! Ground truth: analytic fields, phantoms and hostile files with known answers.
//!
//! Everything that a test compares with is computed here without the engine. The modules are
//! - [`fields`]: the scenes, sampled at lattice points, with conservative ranges;
//! - [`exact`]: area, volume and topology of a scene from formulas and quadrature;
//! - [`lattice`]: counts and topology of the sampled scene, streamed slice by slice;
//! - [`hostile`]: ways to damage a file;
//! - [`texture`]: wood and marble as colours of space;
//! - [`rng`]: the fixed random numbers of all of them.
//!
//! Only [`adapter`] and [`TextureField`] know the engine: they present scenes and textures as a
//! [`brickmarch::Field`].
//!
//! ```
//! use brickmarch_data_gen::{Scene, SceneName, Side, lattice_euler};
//! let scene = Scene::new(SceneName::Torus, 48).unwrap();
//! let found = lattice_euler(&scene, scene.iso(), scene.inside());
//! assert!(found.is_unambiguous());
//! assert_eq!(found.capped.mesh_euler(), scene.exact().unwrap().euler.unwrap());
//! assert_eq!(scene.inside(), Side::Below);
//! ```

pub mod adapter;
mod distance;
pub mod exact;
pub mod fields;
mod gyroid;
mod gyroid_exact;
pub mod hostile;
pub mod lattice;
mod noise;
pub mod phantom;
mod quadrature;
pub mod rng;
mod runs;
pub mod texture;
mod texture_field;
mod trig;

pub use adapter::SceneField;
pub use exact::Exact;
pub use fields::{Meaning, Sample, Scene, SceneError, SceneName, Side};
pub use lattice::{Counts, Topology, lattice_euler};
pub use rng::Rng;
pub use texture::Texture;
pub use texture_field::TextureField;

use crate::render::*;
use brickmarch::*;
use brickmarch::field::*;
use brickmarch::iso::*;
fn shot(name: &str, field: &dyn Field, iso: f32, view: [f64;2], colour: [u8;3], size: [u32;2]) {
    let budget = Budget::mib(256);
    let b = crossing_bounds(field, field.grid().domain, iso, field.kind().inside()).unwrap();
    let look = Look { width: size[0], height: size[1], view: View{azimuth_deg: view[0], elevation_deg: view[1]}, colour, ..Look::default() };
    let mut r = Raster::new(&look, &b, &budget).unwrap();
    let t = std::time::Instant::now();
    let s = extract(field, &Extract{iso, normals: true, ..Default::default()}, &budget, &mut r).unwrap();
    eprintln!("{s:?} {:?}", t.elapsed());
    let t = std::time::Instant::now();
    let p = r.picture(&budget).unwrap();
    eprintln!("shade {:?}", t.elapsed());
    let n = p.write_png(std::path::Path::new(name), crate::output::Replace::Yes).unwrap();
    eprintln!("{n} bytes {} peak", crate::job::Job::peak_text());
}
#[test]
fn ct() {
    let raw = std::fs::read("/tmp/ct.raw").unwrap();
    let mut v = vec![0f32; raw.len()/2];
    SampleType::I16.to_f32(&raw, &mut v);
    let grid = Grid{ index_to_world: Affine::from_spacing([0.78125,0.78125,1.0],[0.0;3]), ..Grid::new(Box3::from_size([128,128,128]))};
    let f = Dense::new(grid, v).unwrap();
    shot("/tmp/ct.png", &f, 200.0, [25.0, 15.0], [232,217,190], [1200,900]);
    shot("/tmp/ct2.png", &f, 200.0, [150.0, 20.0], [232,217,190], [1200,900]);
    let o = crate::cmd::slice::Options{axis:2,index:64,window:None,map:crate::args::MapName::Grey,scale:4.0};
    let d = crate::cmd::slice::draw(&f, f.grid().domain, &o, &Budget::mib(64)).unwrap();
    d.picture.write_png(std::path::Path::new("/tmp/slice.png"), crate::output::Replace::Yes).unwrap();
    let o = crate::cmd::slice::Options{axis:1,index:64,window:None,map:crate::args::MapName::Viridis,scale:4.0};
    let d = crate::cmd::slice::draw(&f, f.grid().domain, &o, &Budget::mib(64)).unwrap();
    d.picture.write_png(std::path::Path::new("/tmp/slice2.png"), crate::output::Replace::Yes).unwrap();
}
#[test]
fn gyroid() {
    let n: i32 = std::env::var("N").ok().map_or(256, |s| s.parse().unwrap());
    let k = std::f64::consts::TAU * 8.0 / n as f64;
    let (s,c): (Vec<f64>,Vec<f64>) = (0..n).map(|i| (k*i as f64).sin_cos()).unzip();
    let f = FromFn::new(Grid::new(Box3::from_size([n,n,n])), Kind::Distance, |p| { let [x,y,z]=p.map(|v| v as usize);
        (s[x]*c[y]+s[y]*c[z]+s[z]*c[x]) as f32 }, |_| Range::UNKNOWN);
    shot("/tmp/gyroid.png", &f, 0.0, [30.0,25.0], [214,156,120], [1200,900]);
}

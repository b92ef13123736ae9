//! From a request to an answer.

use super::Site;
use super::body::{FILE_PART, Held, Region, Reply, Rest};
use super::query::Query;
use super::refusal::Refusal;
use super::route::{self, Part, Route};
use super::shelf::Shown;
use super::surface::{self, CancelOnDrop, Surface};
use crate::args::{Axis, MapName};
use crate::cmd::{info, slice};
use crate::parse;
use crate::picture::Picture;
use crate::render::Look;
use crate::section::axis as section;
use brickmarch::{Box3, Budget, Field, Kind, Permit, SampleType};
use brickmarch_formats::VolumeFormat;
use hyper::body::{Body, Incoming};
use hyper::header::{self, HeaderName, HeaderValue};
use hyper::{Method, Request, Response, StatusCode};
use serde_json::{Value, json};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};

const PAGE: &str = include_str!("page.html");
/// The page holds all that it needs, and may be a part of no other.
const PAGE_POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
     img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// The window that a slice was shown in, low:high.
const WINDOW: HeaderName = HeaderName::from_static("x-brickmarch-window");
/// The level of detail that was taken.
const LEVEL: HeaderName = HeaderName::from_static("x-brickmarch-level");
/// Parts of regions that are read at one time: the largest that leaves most of the memory to others.
const PART_BYTES: [u64; 4] = [16 << 20, 4 << 20, 1 << 20, PART_BYTES_MIN];
const PART_BYTES_MIN: u64 = 256 << 10;
/// How long a surface waits for its memory.
const PATIENCE: Duration = Duration::from_secs(2);
/// Edge that a preview is drawn at, unless another level is asked for.
const PREVIEW_EDGE: u32 = 256;

type Answer = Result<Response<Reply>, Refusal>;

/// Answers every request, whatever is wrong with it.
pub(super) async fn answer(
    site: Arc<Site>,
    request: Request<Incoming>,
) -> Result<Response<Reply>, Infallible> {
    let begun = Instant::now();
    let mut response = respond(&site, &request).await.unwrap_or_else(|refusal| {
        let mut response = json_reply(&refusal.json());
        *response.status_mut() = refusal.status;
        let headers = response.headers_mut();
        match refusal.status {
            StatusCode::SERVICE_UNAVAILABLE => {
                headers.insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
            }
            StatusCode::METHOD_NOT_ALLOWED => {
                headers.insert(header::ALLOW, HeaderValue::from_static("GET, HEAD"));
            }
            _ => {}
        }
        if !request.body().is_end_stream() {
            // What was not read would be taken for the next request.
            headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
        }
        response
    });
    let length = response.body().length();
    let headers = response.headers_mut();
    if !headers.contains_key(header::ETAG) {
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    }
    for (name, value) in [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (
            HeaderName::from_static("cross-origin-resource-policy"),
            "same-origin",
        ),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    site.log(&format!(
        "{} {} {} {} bytes {:.1} ms",
        request.method(),
        super::query::quoted(&request.uri().to_string()),
        response.status().as_u16(),
        length,
        begun.elapsed().as_secs_f64() * 1e3,
    ));
    Ok(response)
}

async fn respond(site: &Arc<Site>, request: &Request<Incoming>) -> Answer {
    if ![Method::GET, Method::HEAD].contains(request.method()) {
        return Err(Refusal::new(
            StatusCode::METHOD_NOT_ALLOWED,
            "only GET and HEAD are answered",
        ));
    }
    if !request.body().is_end_stream() {
        return Err(Refusal::large("requests have no body here"));
    }
    route::check(request, site.loopback)?;
    let query = request.uri().query();
    let route = Route::of(request.uri().path())?;
    let known: &[&str] = match &route {
        // The page may be opened at a volume: its own script reads that.
        Route::Page => return Ok(page()),
        Route::Volumes | Route::About(_) => &[],
        Route::Part(_, Part::Region) => &["min", "max", "level", "format"],
        Route::Part(_, Part::Slice) => &["axis", "at", "level", "window", "map", "scale"],
        Route::Part(_, Part::Value) => &["at", "level"],
        Route::Part(_, Part::Mesh) => &["iso", "label", "level", "inside", "format", "min", "max"],
        Route::Part(_, Part::Preview) => {
            &["iso", "label", "level", "inside", "size", "view", "colour"]
        }
    };
    let query = Query::read(query, known)?;
    match route {
        Route::Page => Ok(page()),
        Route::Volumes => {
            let names: Vec<&str> = site.shelf.names().collect();
            Ok(json_reply(&json!({ "schema": 1, "volumes": names })))
        }
        Route::About(name) => {
            let site = site.clone();
            work(move || about(&site, &name)).await
        }
        Route::Part(name, part) => {
            let level = match (part, query.text("level")) {
                (Part::Preview, None) => preview_level(site, &name).await?,
                _ => query.level()?,
            };
            // Surfaces wait for their turn before they hold anything.
            let turn = match part {
                Part::Mesh | Part::Preview => Some(site.surfaces.acquire().await),
                _ => None,
            };
            let shown = {
                let site = site.clone();
                work(move || site.shelf.get(&name, level)).await?
            };
            let tag = HeaderValue::from_str(&shown.tag()).expect("digits and quotes");
            let mut response = if matches_tag(request, &tag) {
                let mut response = Response::new(Reply::whole(""));
                *response.status_mut() = StatusCode::NOT_MODIFIED;
                response
            } else {
                part_of(site, shown, part, query).await?
            };
            drop(turn);
            let headers = response.headers_mut();
            headers.insert(header::ETAG, tag);
            // Kept, but asked for again each time: the file may have grown.
            headers.insert(
                header::CACHE_CONTROL,
                HeaderValue::from_static("private, no-cache"),
            );
            headers.insert(LEVEL, HeaderValue::from(u16::from(level)));
            Ok(response)
        }
    }
}

async fn part_of(site: &Arc<Site>, shown: Arc<Shown>, part: Part, query: Query) -> Answer {
    let site = site.clone();
    match part {
        Part::Region => work(move || region(&site, shown, &query)).await,
        Part::Slice => work(move || slice_png(&site, &shown, &query)).await,
        Part::Value => work(move || value(&shown, &query)).await,
        Part::Mesh | Part::Preview => {
            let surface = Surface::of(&query)?;
            let picture = match part {
                Part::Preview => Some(surface::look(&query)?),
                _ => None,
            };
            let bytes = surface::memory(picture.as_ref(), site.budget.memory_bytes())?;
            // A share of its own, so that it never takes what others were promised.
            let share = patient(&site.budget, bytes).await?;
            let budget = Budget::bytes(bytes).with_threads(site.budget.threads());
            let gone = CancelOnDrop(budget.cancel_token());
            let (inner, share) = (site.clone(), Arc::new(share));
            let answer = work(move || match picture {
                None => mesh(&inner, &shown, &surface, &query, &budget, &share),
                Some(look) => preview(&inner, &shown, &surface, &look, &budget),
            })
            .await;
            drop(gone);
            answer
        }
    }
}

/// Takes a large permit, for which small answers may have to end first.
async fn patient(budget: &Budget, bytes: u64) -> Result<Permit, Refusal> {
    let begun = Instant::now();
    loop {
        if let Some(permit) = budget.try_take(bytes) {
            return Ok(permit);
        }
        if begun.elapsed() > PATIENCE {
            return Err(Refusal::busy());
        }
        tokio::time::sleep(PATIENCE / 100).await;
    }
}

/// Runs what takes time, or waits for a disk, on a thread that may.
async fn work<T: Send + 'static>(
    job: impl FnOnce() -> Result<T, Refusal> + Send + 'static,
) -> Result<T, Refusal> {
    let done = tokio::task::spawn_blocking(job).await;
    done.unwrap_or_else(|_| {
        Err(Refusal::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "a fault of the program: please report it",
        ))
    })
}

fn reply(kind: &'static str, body: Reply) -> Response<Reply> {
    let length = body.length();
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(length));
    response
}

fn json_reply(value: &Value) -> Response<Reply> {
    reply("application/json", Reply::whole(format!("{value}\n")))
}

fn page() -> Response<Reply> {
    let mut response = reply("text/html; charset=utf-8", Reply::whole(PAGE));
    let policy = HeaderValue::from_static(PAGE_POLICY);
    response
        .headers_mut()
        .insert(header::CONTENT_SECURITY_POLICY, policy);
    response
}

/// Whether the client has what would be sent.
fn matches_tag(request: &Request<Incoming>, tag: &HeaderValue) -> bool {
    let fields = request.headers().get_all(header::IF_NONE_MATCH);
    let tag = tag.as_bytes();
    fields.iter().any(|field| {
        field
            .as_bytes()
            .split(|&b| b == b',')
            .map(|t| t.trim_ascii())
            .any(|t| t == b"*" || t.strip_prefix(b"W/").unwrap_or(t) == tag)
    })
}

/// What a program, or the page, must know of a volume.
fn about(site: &Site, name: &str) -> Answer {
    let shown = site.shelf.get(name, 0)?;
    let volume = &shown.volume;
    let (spec, info) = (volume.spec(), volume.info()?);
    let mut levels = Vec::new();
    let mut at = spec.clone();
    for level in 0..=volume.levels() {
        if level > 0 {
            at = at.coarser();
        }
        levels.push(json!({
            "level": level, "size": at.grid.domain.size(),
            "domain": { "min": at.grid.domain.min, "max": at.grid.domain.max },
            "index_to_world": at.grid.index_to_world.rows,
        }));
    }
    Ok(json_reply(&json!({
        "schema": 1, "name": name, "background": spec.background, "history": spec.history,
        "generation": info.generation, "sealed": info.sealed,
        "unfinished_slabs": info.unfinished_slabs, "levels": levels,
        "max_region_bytes": site.max_region_bytes, "volume": info::figures(&info, &spec.grid),
    })))
}

/// Samples, byte for byte as `export` writes them.
fn region(site: &Site, shown: Arc<Shown>, query: &Query) -> Answer {
    let spec = shown.volume.spec();
    let region = query.region(&spec.grid)?;
    let format = query.get("format", |text| match text {
        "raw" => Ok(VolumeFormat::Raw),
        "npy" => Ok(VolumeFormat::Npy),
        _ => Err("write raw or npy".to_string()),
    })?;
    let bytes = u128::from(region.count()) * spec.sample.bytes() as u128;
    if bytes > u128::from(site.max_region_bytes) {
        return Err(Refusal::large(format!(
            "the region has {bytes} bytes, more than the {} that are sent at one time: \
             ask for parts of it, or a coarser level",
            site.max_region_bytes
        )));
    }
    let format = format.unwrap_or(VolumeFormat::Raw);
    // Two parts: one that is being sent, one that is being read.
    let (plan, permit) = PART_BYTES
        .iter()
        .find_map(|&most| {
            let plan = brickmarch_formats::plain_parts(spec, region, format, most);
            let bytes = 2 * (plan.part_bytes + 4096);
            let modest = bytes <= site.budget.free_bytes() / 4 || most == PART_BYTES_MIN;
            let permit = modest.then(|| site.budget.try_take(bytes)).flatten()?;
            Some((plan, Arc::new(permit)))
        })
        .ok_or_else(Refusal::busy)?;
    let length = plan.header.len() as u64 + plan.sample_bytes;
    let parts = Region {
        shown: shown.clone(),
        header: plan.header,
        parts: plan.parts,
        permit,
    };
    Ok(reply(
        "application/octet-stream",
        Reply::parts(length, Box::new(parts)),
    ))
}

/// One plane as a picture.
fn slice_png(site: &Site, shown: &Shown, query: &Query) -> Answer {
    let volume = &shown.volume;
    let grid = volume.grid();
    let axis = query.word::<Axis>("axis")?.unwrap_or(Axis::Z) as usize;
    let middle = grid.domain.min[axis] + (grid.domain.size()[axis] / 2) as i32;
    let options = slice::Options {
        axis,
        index: query.get("at", super::query::number)?.unwrap_or(middle),
        window: query.get("window", parse::window)?,
        map: query
            .word::<MapName>("map")?
            .unwrap_or(match volume.kind() {
                Kind::Label => MapName::Labels,
                _ => MapName::Grey,
            }),
        scale: query.get("scale", scale)?.unwrap_or(1.0),
    };
    let plane = section::plane(grid.domain, options.axis, options.index)?;
    let pixels = section::pixels(grid, plane, options.axis, options.scale)?;
    let paper = u64::from(pixels[0]) * u64::from(pixels[1]) * 3;
    let png_max = paper + paper / 64 + (64 << 10);
    let need = plane.count() * 8 + paper;
    let all = need + png_max;
    if all > (site.budget.memory_bytes() / 4).min(site.max_region_bytes.saturating_mul(4)) {
        return Err(Refusal::large(format!(
            "the slice has {} samples and {} x {} pixels: ask for a coarser level or a smaller scale",
            plane.count(),
            pixels[0],
            pixels[1]
        )));
    }
    let mut permit = site.budget.try_take(all).ok_or_else(Refusal::busy)?;
    let drawn = slice::draw(volume, grid.domain, &options, &Budget::bytes(need))?;
    let mut response = png_reply(&drawn.picture, png_max, || {
        permit.try_resize(png_max);
        permit
    })?;
    let (low, high) = drawn.window;
    if let Ok(window) = HeaderValue::from_str(&format!("{low}:{high}")) {
        response.headers_mut().insert(WINDOW, window);
    }
    Ok(response)
}

/// Encodes a picture into memory that is under the permit that `permit` gives.
fn png_reply(picture: &Picture, bytes_max: u64, permit: impl FnOnce() -> Permit) -> Answer {
    let mut bytes = Vec::with_capacity(bytes_max as usize);
    picture
        .encode_png(&mut bytes, png::Compression::Fast)
        .map_err(|e| Refusal::new(StatusCode::INTERNAL_SERVER_ERROR, e.to_string()))?;
    bytes.shrink_to_fit();
    let permit = Arc::new(permit());
    let held = Held { bytes, permit }.into_bytes();
    Ok(reply("image/png", Reply::whole(held)))
}

fn scale(text: &str) -> Result<f64, String> {
    parse::finite(text).and_then(|value| {
        if (0.01..=16.0).contains(&value) {
            Ok(value)
        } else {
            Err("write a number from 0.01 to 16".to_string())
        }
    })
}

/// One sample.
fn value(shown: &Shown, query: &Query) -> Answer {
    let volume = &shown.volume;
    let at = query.need("at", parse::triple::<i32>)?;
    let grid = volume.grid();
    let inside = (0..3).all(|a| (grid.domain.min[a]..grid.domain.max[a]).contains(&at[a]));
    if !inside {
        return Err(Refusal::bad(format!(
            "{at:?} is not inside the domain {}",
            grid.domain
        )));
    }
    let sample: SampleType = volume.spec().sample;
    let mut raw = [0u8; 4];
    let raw = &mut raw[..sample.bytes()];
    volume.read_raw(Box3::new(at, at.map(|v| v + 1)), raw)?;
    let value = sample.get(raw);
    Ok(json_reply(&json!({
        // JSON has no number for NaN and the infinities: they are null, and the text tells.
        "at": at, "value": value, "text": value.to_string(),
        "world": grid.index_to_world.apply(at.map(f64::from)), "units": grid.units.name(),
    })))
}

/// A mesh, made into a file that goes when it was sent.
fn mesh(
    site: &Site,
    shown: &Shown,
    surface: &Surface,
    query: &Query,
    budget: &Budget,
    share: &Arc<Permit>,
) -> Answer {
    let ending = query.get("format", |text| match text {
        "ply" => Ok("ply"),
        "stl" => Ok("stl"),
        _ => Err("write ply or stl".to_string()),
    })?;
    let ending = ending.unwrap_or("ply");
    let cells = match query.text("min").or(query.text("max")) {
        Some(_) => Some(query.region(shown.volume.grid())?),
        None => None,
    };
    let path = site.scratch_path(ending);
    surface.mesh(shown, cells, &path, site.max_region_bytes, budget)?;
    let failed = |e: std::io::Error| {
        Refusal::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            format!("the mesh cannot be read back: {e}"),
        )
    };
    let file = std::fs::File::open(&path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    // Where an open file cannot be removed it goes with its folder.
    let _ = std::fs::remove_file(&path);
    let permit = site.budget.try_take(2 * FILE_PART as u64);
    // The share covers the parts where nothing else is free.
    let permit = permit.map_or_else(|| share.clone(), Arc::new);
    let mut response = reply(
        "application/octet-stream",
        Reply::parts(length, Box::new(Rest { file, permit })),
    );
    let name = format!("attachment; filename=\"mesh.{ending}\"");
    if let Ok(name) = HeaderValue::from_str(&name) {
        response
            .headers_mut()
            .insert(header::CONTENT_DISPOSITION, name);
    }
    Ok(response)
}

/// The finest level that is small enough to be drawn at once, or else the coarsest.
async fn preview_level(site: &Arc<Site>, name: &str) -> Result<u8, Refusal> {
    let (site, name) = (site.clone(), name.to_string());
    work(move || {
        let shown = site.shelf.get(&name, 0)?;
        let size = shown.volume.grid().domain.size();
        let edge = size.into_iter().max().unwrap_or(1);
        let levels = shown.volume.levels();
        let fits = (0..levels).find(|&level| edge.div_ceil(1 << level) <= PREVIEW_EDGE);
        Ok(fits.unwrap_or(levels))
    })
    .await
}

/// A shaded picture of a surface.
fn preview(site: &Site, shown: &Shown, surface: &Surface, look: &Look, budget: &Budget) -> Answer {
    let picture = surface.picture(shown, look, budget)?;
    let paper = picture.bytes.len() as u64;
    let png_max = paper + paper / 64 + (64 << 10);
    let permit = site.budget.try_take(png_max).ok_or_else(Refusal::busy)?;
    png_reply(&picture, png_max, || permit)
}

//! Addresses: who is asked (against rebinding of names), and for what.

use super::query::{decode, quoted};
use super::refusal::Refusal;
use hyper::header::HOST;
use hyper::{Request, StatusCode};

/// Longest address.
const URI_MAX: usize = 2048;

/// What is asked for.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Route {
    Page,
    Volumes,
    /// What is known of a volume.
    About(String),
    /// A part of a volume.
    Part(String, Part),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Region,
    Slice,
    Value,
    Mesh,
    Preview,
}

impl Route {
    /// Reads a path.
    ///
    /// # Errors
    /// 404, and 400 for a path that is not percent-encoded text.
    pub(super) fn of(path: &str) -> Result<Route, Refusal> {
        let lost = || {
            Refusal::missing(
                "there is nothing here; there are /, /api/volumes, /api/volumes/NAME and \
                 /api/volumes/NAME/region, slice, value, mesh, preview",
            )
        };
        if path == "/" {
            return Ok(Route::Page);
        }
        let path = path.strip_prefix("/api/volumes").ok_or_else(lost)?;
        let words: Vec<&str> = path.split('/').collect();
        match words[..] {
            [""] => Ok(Route::Volumes),
            ["", name] => Ok(Route::About(decode(name)?)),
            ["", name, part] => {
                let part = match part {
                    "region" => Part::Region,
                    "slice" => Part::Slice,
                    "value" => Part::Value,
                    "mesh" => Part::Mesh,
                    "preview" => Part::Preview,
                    _ => return Err(lost()),
                };
                Ok(Route::Part(decode(name)?, part))
            }
            _ => Err(lost()),
        }
    }
}

/// Refuses what is too long, or was meant for another machine.
///
/// A page of a stranger can make its own name lead to 127.0.0.1; the browser then lets it read our
/// answers, but still says whom it means to ask. So on a loopback address only requests to one of
/// its names are answered.
///
/// # Errors
/// 414, 421.
pub(super) fn check<B>(request: &Request<B>, loopback: bool) -> Result<(), Refusal> {
    let uri = request.uri();
    let length = uri.path().len() + uri.query().map_or(0, str::len);
    if length > URI_MAX {
        return Err(Refusal::new(
            StatusCode::URI_TOO_LONG,
            format!("an address of {length} bytes: at most {URI_MAX} are read"),
        ));
    }
    let fields: Vec<_> = request.headers().get_all(HOST).iter().collect();
    if fields.len() > 1 {
        return Err(Refusal::bad("more than one Host"));
    }
    let host = match (uri.authority(), fields.first()) {
        (Some(authority), _) => Some(authority.as_str()),
        (None, Some(field)) => Some(field.to_str().unwrap_or("?")),
        (None, None) if request.version() >= hyper::Version::HTTP_11 => {
            return Err(Refusal::bad("there is no Host"));
        }
        (None, None) => None,
    };
    match host {
        Some(host) if loopback && !is_local(host) => Err(Refusal::new(
            StatusCode::MISDIRECTED_REQUEST,
            format!(
                "{} is not this machine: ask localhost, 127.0.0.1 or [::1]",
                quoted(host)
            ),
        )),
        _ => Ok(()),
    }
}

/// Whether a host, with or without a port, is a name of this machine.
fn is_local(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name
        .strip_prefix('[')
        .and_then(|n| n.strip_suffix(']'))
        .unwrap_or(name);
    name.eq_ignore_ascii_case("localhost")
        || name
            .parse::<std::net::IpAddr>()
            .is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths() {
        assert_eq!(Route::of("/").expect("known"), Route::Page);
        assert_eq!(Route::of("/api/volumes").expect("known"), Route::Volumes);
        assert_eq!(
            Route::of("/api/volumes/a%2Fb/slice").expect("known"),
            Route::Part("a/b".into(), Part::Slice)
        );
        for lost in [
            "",
            "//",
            "/index.html",
            "/api",
            "/api/volumesx",
            "/../etc/passwd",
            "/api/volumes/a/b",
            "/api/volumes/a/slice/",
            "/api/volumes/../../etc/passwd",
            "*",
        ] {
            assert_eq!(Route::of(lost).expect_err(lost).status, 404, "{lost}");
        }
    }

    #[test]
    fn names_of_this_machine() {
        for yes in [
            "localhost",
            "LocalHost:80",
            "127.0.0.1:8400",
            "127.9.9.9",
            "[::1]",
            "[::1]:1",
        ] {
            assert!(is_local(yes), "{yes}");
        }
        for no in [
            "",
            "example.org",
            "localhost.example.org",
            "10.0.0.1",
            "127.0.0.1.nip.io:80",
            "[::2]",
        ] {
            assert!(!is_local(no), "{no}");
        }
    }
}

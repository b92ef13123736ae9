//! One scene file: its parameters, its parts, and the files that it includes.

use super::Scene;
use super::keys::Keys;
use super::value::{self, Item, Table, Value};
use brickmarch::model::{Expression, Shape};
use brickmarch::{Budget, Error, Result, Units};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// How deep files may include each other, and parts may use each other.
const MAX_INCLUDES: usize = 16;
const MAX_NESTING: usize = 100;

/// Most nodes of a part, uses of other parts counted in full.
const MAX_NODES: usize = 100_000;

/// Most files of one scene.
const MAX_FILES: usize = 256;

pub(super) struct Scope {
    pub(super) path: PathBuf,
    pub(super) budget: Budget,
    parameters: BTreeMap<String, f64>,
    parts: Table,
    model: Option<Item>,
    includes: BTreeMap<String, Scope>,
    done: RefCell<BTreeMap<String, (Shape, usize)>>,
    /// Parts that are being made now, from the outermost.
    open: RefCell<Vec<String>>,
    depth: RefCell<usize>,
}

/// The name of the part that a file is made for.
const MODEL: &str = "model";

/// # Errors
/// Those of [`Scene::read`].
pub(super) fn read(path: &Path, budget: &Budget) -> Result<Scene> {
    let mut files = 0;
    let (scope, table) = load(path, budget, &BTreeMap::new(), &mut Vec::new(), &mut files)?;
    let keys = Keys::new(&scope, 1, &table);
    let title = keys.text("title")?.unwrap_or_default().to_string();
    let units = match keys.choice("units", &["none", "um", "mm", "m", "nm"])? {
        Some("um") => Units::Micrometre,
        Some("mm") => Units::Millimetre,
        Some("m") => Units::Metre,
        Some("nm") => Units::Nanometre,
        _ => Units::Unknown,
    };
    let resolution = keys.whole("resolution", 1 << 20)?;
    let bounds = bounds(&scope, keys.need("bounds")?)?;
    for key in ["include", "parameters", "parts", MODEL] {
        keys.get(key);
    }
    keys.finish()?;
    if let (0, Some(item)) = (resolution.unwrap_or(1), table.get("resolution")) {
        return Err(scope.error(item.line, "'resolution' is 0: give at least 1".into()));
    }
    // Parts that the model does not use are checked too.
    for name in scope.parts.keys() {
        scope.part(1, name)?;
    }
    let (shape, _) = scope.part(1, MODEL)?;
    Ok(Scene {
        title,
        shape,
        bounds,
        units,
        resolution,
    })
}

fn bounds(scope: &Scope, item: &Item) -> Result<[[f64; 3]; 2]> {
    let Value::Table(table) = &item.value else {
        return Err(scope.error(
            item.line,
            "'bounds' is no table: give { min = [x, y, z], max = [x, y, z] }".into(),
        ));
    };
    let keys = Keys::new(scope, item.line, table);
    let low = keys.need_vector("min")?;
    let high = keys.need_vector("max")?;
    keys.finish()?;
    if (0..3).any(|a| high[a] - low[a] < 1e-30) {
        return Err(scope.error(
            item.line,
            format!("bounds {low:?} to {high:?} are empty: give a max above the min on every axis"),
        ));
    }
    Ok([low, high])
}

fn load(
    path: &Path,
    budget: &Budget,
    set: &BTreeMap<String, f64>,
    above: &mut Vec<PathBuf>,
    files: &mut usize,
) -> Result<(Scope, Table)> {
    let table = value::read(path)?;
    let mut scope = Scope {
        path: path.to_path_buf(),
        budget: budget.clone(),
        parameters: BTreeMap::new(),
        parts: Table::new(),
        model: table.get(MODEL).cloned(),
        includes: BTreeMap::new(),
        done: RefCell::default(),
        open: RefCell::default(),
        depth: RefCell::default(),
    };
    scope.parameters = parameters(&scope, table.get("parameters"), set)?;
    if let Some(item) = table.get("parts") {
        let Value::Table(parts) = &item.value else {
            return Err(scope.error(
                item.line,
                "'parts' is no table: write [parts.NAME] for each part".into(),
            ));
        };
        if let Some((name, item)) = parts.iter().find(|(n, _)| n.contains('.') || *n == MODEL) {
            return Err(scope.error(
                item.line,
                format!("a part cannot be called '{name}': choose a name without dots that is not '{MODEL}'"),
            ));
        }
        scope.parts = parts.clone();
    }
    let own = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    above.push(own);
    scope.includes = includes(&scope, table.get("include"), above, files)?;
    above.pop();
    Ok((scope, table))
}

/// Values of parameters, which may use each other in any order.
fn parameters(
    scope: &Scope,
    item: Option<&Item>,
    set: &BTreeMap<String, f64>,
) -> Result<BTreeMap<String, f64>> {
    let empty = Table::new();
    let (line, table) = match item {
        None => (1, &empty),
        Some(Item {
            line,
            value: Value::Table(table),
        }) => (*line, table),
        Some(item) => {
            return Err(scope.error(
                item.line,
                "'parameters' is no table: write [parameters] and name = value lines".into(),
            ));
        }
    };
    if let Some(name) = set.keys().find(|n| !table.contains_key(*n)) {
        return Err(scope.error(
            line,
            format!("there is no parameter '{name}' to be set: add it to [parameters]"),
        ));
    }
    let mut known = set.clone();
    let mut open: Vec<(&String, &Item)> = table
        .iter()
        .filter(|(n, _)| !set.contains_key(*n))
        .collect();
    while !open.is_empty() {
        let before = open.len();
        let mut failed = None;
        let mut left = Vec::new();
        for (name, item) in open {
            let value = match &item.value {
                Value::Number(v) => Ok(*v),
                Value::Text(text) => Expression::parse(text, &|n| known.get(n).copied())
                    .map_err(|e| e.to_string())
                    .and_then(|e| {
                        e.constant()
                            .filter(|v| v.is_finite())
                            .ok_or_else(|| "its value is not a finite number".to_string())
                    }),
                other => Err(format!(
                    "is {}: give a number or a formula in quotes",
                    other.noun()
                )),
            };
            match value {
                Ok(value) => {
                    known.insert(name.clone(), value);
                }
                Err(message) => {
                    failed.get_or_insert((item.line, format!("parameter '{name}': {message}")));
                    left.push((name, item));
                }
            }
        }
        if let (true, Some((line, message))) = (left.len() == before, failed) {
            return Err(scope.error(line, message));
        }
        open = left;
    }
    Ok(known)
}

fn includes(
    scope: &Scope,
    item: Option<&Item>,
    above: &mut Vec<PathBuf>,
    files: &mut usize,
) -> Result<BTreeMap<String, Scope>> {
    let mut out = BTreeMap::new();
    let Some(item) = item else { return Ok(out) };
    let Value::List(list) = &item.value else {
        return Err(scope.error(
            item.line,
            "'include' is no list: write include = [\"file.toml\"]".into(),
        ));
    };
    for entry in list {
        let (file, name, set) = match &entry.value {
            Value::Text(file) => (file.as_str(), None, BTreeMap::new()),
            Value::Table(table) => {
                let keys = Keys::new(scope, entry.line, table);
                keys.need("file")?;
                let file = keys.text("file")?.unwrap_or_default();
                let name = keys.text("as")?;
                let mut set = BTreeMap::new();
                if let Some(item) = keys.get("set") {
                    let Value::Table(values) = &item.value else {
                        return Err(scope.error(
                            item.line,
                            "'set' is no table: write set = { name = value }".into(),
                        ));
                    };
                    for (key, item) in values {
                        set.insert(key.clone(), scope.number(key, item)?);
                    }
                }
                keys.finish()?;
                (file, name, set)
            }
            other => {
                return Err(scope.error(
                    entry.line,
                    format!(
                        "{} in 'include': give a file name, or {{ file = \"...\", as = \"name\" }}",
                        other.noun()
                    ),
                ));
            }
        };
        let path = scope.beside(file);
        let real = path.canonicalize().map_err(|e| {
            scope.error(
                entry.line,
                format!("cannot include {}: {e}: correct the name", path.display()),
            )
        })?;
        if above.contains(&real) {
            return Err(scope.error(
                entry.line,
                format!("{} includes itself: break the circle", path.display()),
            ));
        }
        *files += 1;
        if above.len() >= MAX_INCLUDES || *files > MAX_FILES {
            return Err(scope.error(
                entry.line,
                format!(
                    "more than {MAX_INCLUDES} levels or {MAX_FILES} files of includes: include less"
                ),
            ));
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let name = name.unwrap_or(&stem).to_string();
        let (inner, _) = load(&path, &scope.budget, &set, above, files)?;
        if scope.parts.contains_key(&name) || out.insert(name.clone(), inner).is_some() {
            return Err(scope.error(
                entry.line,
                format!("the name '{name}' is taken: choose another one with as = \"...\""),
            ));
        }
    }
    Ok(out)
}

impl Scope {
    /// An error of this file.
    pub(super) fn error(&self, line: usize, message: String) -> Error {
        Error::bad_input(format!("{}:{line}: {message}", self.path.display()))
    }

    /// A file named in this one.
    pub(super) fn beside(&self, file: &str) -> PathBuf {
        self.path.parent().unwrap_or(Path::new(".")).join(file)
    }

    /// A number or a formula of parameters.
    pub(super) fn number(&self, key: &str, item: &Item) -> Result<f64> {
        match &item.value {
            Value::Number(v) => Ok(*v),
            Value::Text(text) => {
                let formula = self.formula(item.line, key, text)?;
                let value = formula.constant().filter(|v| v.is_finite());
                value.ok_or_else(|| {
                    self.error(
                        item.line,
                        format!("'{key}': \"{text}\" is not one finite number: use numbers and parameters only"),
                    )
                })
            }
            other => Err(self.error(
                item.line,
                format!(
                    "'{key}' is {}: give a number or a formula in quotes",
                    other.noun()
                ),
            )),
        }
    }

    pub(super) fn formula(&self, line: usize, key: &str, text: &str) -> Result<Expression> {
        Expression::parse(text, &|name| self.parameters.get(name).copied())
            .map_err(|e| self.error(line, format!("'{key}': {e}")))
    }

    /// `N` numbers.
    pub(super) fn numbers<const N: usize>(&self, key: &str, item: &Item) -> Result<[f64; N]> {
        let wrong = || {
            self.error(
                item.line,
                format!("'{key}': give a list of {N} numbers, as in {:?}", [0.5; N]),
            )
        };
        let Value::List(list) = &item.value else {
            return Err(wrong());
        };
        let values: Vec<f64> = list
            .iter()
            .map(|item| self.number(key, item))
            .collect::<Result<_>>()?;
        values.try_into().map_err(|_| wrong())
    }

    pub(super) fn vector(&self, key: &str, item: &Item) -> Result<[f64; 3]> {
        self.numbers(key, item)
    }

    /// A part by its name, and how many nodes it has; `line` is where it is used.
    pub(super) fn part(&self, line: usize, name: &str) -> Result<(Shape, usize)> {
        if let Some(done) = self.done.borrow().get(name) {
            return Ok(done.clone());
        }
        if let Some((file, inner)) = name.split_once('.') {
            let include = self.includes.get(file);
            let include = include.ok_or_else(|| self.no_part(line, name))?;
            return include.part(line, inner);
        }
        let item = match (name == MODEL, self.parts.get(name)) {
            (true, _) => self.model.as_ref(),
            (false, item) => item,
        };
        let Some(item) = item else {
            if let Some(include) = self.includes.get(name) {
                return include.part(line, MODEL);
            }
            return Err(self.no_part(line, name));
        };
        if self.open.borrow().iter().any(|n| n == name) {
            let mut circle = self.open.borrow().join(" -> ");
            circle.push_str(&format!(" -> {name}"));
            return Err(self.error(
                line,
                format!("part '{name}' uses itself ({circle}): break the circle"),
            ));
        }
        self.open.borrow_mut().push(name.to_string());
        let made = self.item(item, name);
        self.open.borrow_mut().pop();
        let made = made?;
        self.done
            .borrow_mut()
            .insert(name.to_string(), made.clone());
        Ok(made)
    }

    fn no_part(&self, line: usize, name: &str) -> Error {
        if name == MODEL {
            return self.error(
                1,
                "there is no [model]: add it, with the same keys as a part".into(),
            );
        }
        let mut known: Vec<&str> = self.parts.keys().map(String::as_str).collect();
        known.extend(self.includes.keys().map(String::as_str));
        let known = if known.is_empty() {
            "there are none; write [parts.NAME]".to_string()
        } else {
            format!("there are {}", known.join(", "))
        };
        self.error(line, format!("no part is called '{name}': {known}"))
    }

    /// A part as it is written: a name or a table.
    pub(super) fn item(&self, item: &Item, what: &str) -> Result<(Shape, usize)> {
        let nested = {
            let mut depth = self.depth.borrow_mut();
            *depth += 1;
            *depth
        };
        if nested > MAX_NESTING {
            return Err(self.error(
                item.line,
                format!("parts are nested more than {MAX_NESTING} deep: make the tree flatter"),
            ));
        }
        let made = match &item.value {
            Value::Text(name) => self.part(item.line, name),
            Value::Table(table) => super::part::part(self, item.line, table),
            other => Err(self.error(
                item.line,
                format!(
                    "'{what}' is {}: give the name of a part, or a part in {{ }}",
                    other.noun()
                ),
            )),
        };
        *self.depth.borrow_mut() -= 1;
        let (shape, nodes) = made?;
        if nodes > MAX_NODES {
            return Err(self.error(
                item.line,
                format!("'{what}' has more than {MAX_NODES} nodes: use 'repeat' for copies"),
            ));
        }
        Ok((shape, nodes))
    }
}

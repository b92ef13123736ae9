//! `sample`: values, and gradients, of a volume at points.

use super::ask::{self, Put};
use super::{named, pick, seconds, thousands};
use crate::Outcome;
use crate::args::Sample;
use crate::job::Job;
use crate::output::{self, Replace};
use crate::table::Rows;
use brickmarch::query::{
    Sampling, TakePoints, are_scattered, sample_gradients, sample_gradients_again, sample_points,
    sample_points_again,
};
use brickmarch::store::Volume;
use brickmarch::{Budget, Field, Result};
use serde_json::json;

pub(crate) fn run(args: &Sample) -> anyhow::Result<Outcome> {
    let replace = Replace::from(&args.overwrite);
    if let Some(out) = &args.out {
        output::check_target(out, replace)?;
    }
    let job = Job::new(&args.run);
    let volume = pick::open(&args.volume, &args.pick, &job.budget)?;
    let options = Sampling {
        method: args.method.into(),
        space: ask::space(args.space),
        outside: args.outside,
    };
    let names: &[&str] = if args.gradient {
        &["x", "y", "z", "value", "gx", "gy", "gz"]
    } else {
        &["x", "y", "z", "value"]
    };
    let mut without = 0u64;
    let asked = Asked {
        volume: &volume,
        options,
        gradient: args.gradient,
        columns: names.len(),
        budget: &job.budget,
    };
    let count = ask::by_batches(
        &args.points,
        3,
        args.out.as_deref(),
        replace,
        names,
        &job,
        |rows, batch, put| {
            without = asked.answer(rows, batch, put)?;
            Ok(())
        },
    )
    .map_err(named(&[&args.volume, &args.points]))?;
    let Some(out) = &args.out else {
        return Ok(Outcome::Done);
    };
    let text = format!(
        "{}: {} points, {} without a value, {}, peak {}\n",
        out.display(),
        thousands(count),
        thousands(without),
        seconds(job.seconds()),
        Job::peak_text()
    );
    let json = json!({
        "schema": 1, "command": "sample", "out": out, "points": count, "without_value": without,
        "blocks_decoded": volume.blocks_decoded(), "seconds": job.seconds(),
        "peak_rss_bytes": crate::system::peak_resident_bytes(),
    });
    job.result(&text, &json)?;
    Ok(pick::outcome(&volume, &args.volume, &job))
}

/// What is asked at every point.
struct Asked<'a> {
    volume: &'a Volume,
    options: Sampling,
    gradient: bool,
    columns: usize,
    budget: &'a Budget,
}

impl Asked<'_> {
    /// Answers all rows; returns the number of those without a value.
    fn answer(&self, rows: &mut Rows, batch: usize, put: &mut Put<'_>) -> Result<u64> {
        let (mut numbers, mut answers) = (Vec::new(), Vec::new());
        let (mut values, mut slopes) = (Vec::new(), Vec::new());
        let mut without = 0;
        loop {
            let place = rows.place();
            rows.next(batch, &mut numbers)?;
            if numbers.is_empty() {
                return Ok(without);
            }
            let points = numbers.as_chunks::<3>().0;
            if let Some([row, all]) = place
                && all - row > points.len() as u64
                && are_scattered(self.volume, points, self.options.space, self.budget)?
            {
                without += self.answer_scattered(rows, [row, all], batch, put)?;
                continue;
            }
            values.resize(points.len(), 0.0);
            sample_points(self.volume, points, &self.options, &mut values, self.budget)?;
            if self.gradient {
                slopes.resize(points.len(), [0.0; 3]);
                sample_gradients(self.volume, points, &self.options, &mut slopes, self.budget)?;
            }
            without += self.append(points, &values, &slopes, &mut answers);
            put(&mut answers)?;
            self.budget.check_cancelled()?;
        }
    }

    /// Answers as many rows from `row` on as the memory holds answers for. The rows are read again for
    /// each part of the volume, which is then decoded about once.
    fn answer_scattered(
        &self,
        rows: &mut Rows,
        [row, all]: [u64; 2],
        batch: usize,
        put: &mut Put<'_>,
    ) -> Result<u64> {
        let each = 4 + if self.gradient { 12 } else { 0 };
        // The caches of the volume take nearly half of the budget, points that are sorted an eighth.
        let room = (self.budget.free_bytes() / 4).min(self.budget.memory_bytes() / 8);
        let count = (room / each).clamp(batch as u64, all - row);
        let _permit = self
            .budget
            .take(count * each, "answers at points in no order")?;
        let mut values = vec![0.0; count as usize];
        let mut slopes = vec![[0.0; 3]; if self.gradient { values.len() } else { 0 }];
        let mut numbers = Vec::new();
        let mut read = |take: &mut TakePoints<'_>| {
            rows.go_to(row)?;
            let mut left = count as usize;
            while left > 0 {
                rows.next(batch.min(left), &mut numbers)?;
                left -= numbers.len() / 3;
                take(numbers.as_chunks::<3>().0)?;
            }
            Ok(())
        };
        let options = &self.options;
        sample_points_again(self.volume, &mut read, options, &mut values, self.budget)?;
        if self.gradient {
            sample_gradients_again(self.volume, &mut read, options, &mut slopes, self.budget)?;
        }
        rows.go_to(row)?;
        let (mut answers, mut without) = (Vec::new(), 0);
        let mut first = 0;
        while first < values.len() {
            rows.next(batch.min(values.len() - first), &mut numbers)?;
            let points = numbers.as_chunks::<3>().0;
            let end = first + points.len();
            let slopes = slopes.get(first..end).unwrap_or_default();
            without += self.append(points, &values[first..end], slopes, &mut answers);
            put(&mut answers)?;
            first = end;
        }
        Ok(without)
    }

    /// Appends rows of points and answers; returns the number of those without a value.
    fn append(
        &self,
        points: &[[f64; 3]],
        values: &[f32],
        slopes: &[[f32; 3]],
        out: &mut Vec<f64>,
    ) -> u64 {
        let start = out.len();
        out.resize(start + points.len() * self.columns, 0.0);
        let rows = out[start..].chunks_exact_mut(self.columns);
        for ((row, point), &value) in rows.zip(points).zip(values) {
            row[..3].copy_from_slice(point);
            row[3] = f64::from(value);
        }
        for (row, slope) in out[start..].chunks_exact_mut(self.columns).zip(slopes) {
            row[4..].copy_from_slice(&slope.map(f64::from));
        }
        values.iter().filter(|v| v.is_nan()).count() as u64
    }
}

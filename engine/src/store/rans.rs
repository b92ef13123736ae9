//! An entropy coder for bytes: range asymmetric numeral systems with one table of frequencies
//! (J. Duda 2013, <https://arxiv.org/abs/1311.2540>), four states that take turns, so that a
//! processor decodes four symbols side by side. Bytes: section 9 of `docs/format.md`.

/// Frequencies add up to `1 << BITS`.
const BITS: u32 = 11;
const TOTAL: u32 = 1 << BITS;
/// States are at least this; words of 16 bits are taken when one is below.
const LOW: u32 = 1 << 16;
const STATES: usize = 4;

/// How a plane of bytes is stored: its first byte.
const AS_IT_IS: u8 = 0;
const ONE_VALUE: u8 = 1;
const CODED: u8 = 2;

/// Frequencies that add up to [`TOTAL`], none of what occurs being 0. There are at least two values.
fn normalize(counts: &[u32; 256], all: u32) -> [u32; 256] {
    let mut freq = [0; 256];
    let mut sum = 0;
    for (f, &n) in freq.iter_mut().zip(counts) {
        if n > 0 {
            *f = ((u64::from(n) * u64::from(TOTAL) / u64::from(all)) as u32).max(1);
            sum += *f;
        }
    }
    // What rounding has left goes to the most frequent, and is taken from there.
    while sum != TOTAL {
        let most = (0..256)
            .max_by_key(|&s| (freq[s], 255 - s))
            .expect("256 of them");
        if sum < TOTAL {
            freq[most] += TOTAL - sum;
            sum = TOTAL;
        } else {
            let less = (sum - TOTAL).min(freq[most] / 2);
            freq[most] -= less;
            sum -= less;
        }
    }
    freq
}

/// Frequencies one after the other: 0 and how many zeros follow it; 1 to 127; or in two bytes, the high
/// one first, with its highest bit set.
fn put_table(freq: &[u32; 256], out: &mut Vec<u8>) {
    let end = 256 - freq.iter().rev().take_while(|&&f| f == 0).count();
    out.push((end - 1) as u8);
    let mut s = 0;
    while s < end {
        match freq[s] {
            0 => {
                let zeros = freq[s..end].iter().take_while(|&&f| f == 0).count();
                out.extend([0, (zeros - 1) as u8]);
                s += zeros - 1;
            }
            f @ 1..=127 => out.push(f as u8),
            f => out.extend([0x80 | (f >> 8) as u8, f as u8]),
        }
        s += 1;
    }
}

/// Takes a table from the front of `bytes`.
fn table(bytes: &mut &[u8]) -> Option<[u32; 256]> {
    let mut next = || {
        let (&first, rest) = bytes.split_first()?;
        *bytes = rest;
        Some(first)
    };
    let end = usize::from(next()?) + 1;
    let mut freq = [0; 256];
    let (mut s, mut sum) = (0, 0);
    while s < end {
        match next()? {
            0 => s += usize::from(next()?),
            high @ 0x80.. => freq[s] = u32::from(high & 0x7f) << 8 | u32::from(next()?),
            f => freq[s] = f.into(),
        }
        sum += freq.get(s)?;
        s += 1;
    }
    let fits = sum == TOTAL && s == end && freq.iter().all(|&f| f < TOTAL);
    fits.then_some(freq)
}

/// Appends the bytes `plane`, `step` apart in the slice.
pub(super) fn encode(plane: &[u8], step: usize, words: &mut Vec<u16>, out: &mut Vec<u8>) {
    let n = plane.len().div_ceil(step);
    let mut counts = [0u32; 256];
    plane
        .iter()
        .step_by(step)
        .for_each(|&b| counts[usize::from(b)] += 1);
    if counts.contains(&(n as u32)) {
        out.extend([ONE_VALUE, plane[0]]);
        return;
    }
    let freq = normalize(&counts, n as u32);
    let mut start = [0; 256];
    for s in 1..256 {
        start[s] = start[s - 1] + freq[s - 1];
    }
    let begin = out.len();
    out.push(CODED);
    put_table(&freq, out);
    // The last symbol first: a decoder takes them in order.
    words.clear();
    let mut states = [LOW; STATES];
    for i in (0..n).rev() {
        let s = usize::from(plane[i * step]);
        let x = &mut states[i % STATES];
        if *x >> (32 - BITS) >= freq[s] {
            words.push(*x as u16);
            *x >>= 16;
        }
        *x = ((*x / freq[s]) << BITS) + *x % freq[s] + start[s];
    }
    out.extend((words.len() as u32).to_le_bytes());
    states.iter().for_each(|x| out.extend(x.to_le_bytes()));
    words.iter().rev().for_each(|w| out.extend(w.to_le_bytes()));
    if out.len() - begin > n {
        out.truncate(begin);
        out.push(AS_IT_IS);
        out.extend(plane.iter().step_by(step));
    }
}

/// A symbol by the low bits of a state.
#[derive(Clone, Copy, Default)]
struct Slot {
    symbol: u8,
    freq: u16,
    /// How far the bits are above the first of the symbol.
    above: u16,
}

/// Takes a plane from the front of `bytes` into every `step`-th byte of `out`.
pub(super) fn decode(bytes: &mut &[u8], step: usize, out: &mut [u8]) -> Option<()> {
    let n = out.len().div_ceil(step);
    let (&kind, mut rest) = bytes.split_first()?;
    match kind {
        AS_IT_IS => {
            let (plane, after) = rest.split_at_checked(n)?;
            out.iter_mut()
                .step_by(step)
                .zip(plane)
                .for_each(|(o, &b)| *o = b);
            rest = after;
        }
        ONE_VALUE => {
            let (&value, after) = rest.split_first()?;
            out.iter_mut().step_by(step).for_each(|o| *o = value);
            rest = after;
        }
        CODED => {
            let freq = table(&mut rest)?;
            let (count, after) = rest.split_first_chunk::<4>()?;
            let (states, after) = after.split_first_chunk::<{ 4 * STATES }>()?;
            let length = (u32::from_le_bytes(*count) as usize).checked_mul(2)?;
            let (words, after) = after.split_at_checked(length)?;
            let mut x = [0; STATES];
            for (x, four) in x.iter_mut().zip(states.as_chunks::<4>().0) {
                *x = u32::from_le_bytes(*four);
            }
            symbols(&freq, x, words.as_chunks::<2>().0, step, out)?;
            rest = after;
        }
        _ => return None,
    }
    *bytes = rest;
    Some(())
}

/// Decodes all symbols; nothing when the words do not end where the symbols do.
fn symbols(
    freq: &[u32; 256],
    mut states: [u32; STATES],
    words: &[[u8; 2]],
    step: usize,
    out: &mut [u8],
) -> Option<()> {
    let mut slots = [Slot::default(); TOTAL as usize];
    let mut at = 0;
    for (s, &f) in freq.iter().enumerate() {
        for (above, slot) in slots[at..at + f as usize].iter_mut().enumerate() {
            *slot = Slot {
                symbol: s as u8,
                freq: f as u16,
                above: above as u16,
            };
        }
        at += f as usize;
    }
    let mut next = 0;
    let mut take = |x: &mut u32| {
        let slot = slots[(*x & (TOTAL - 1)) as usize];
        let new = u32::from(slot.freq)
            .wrapping_mul(*x >> BITS)
            .wrapping_add(slot.above.into());
        // No branch: half of them would be guessed wrong. Past the end there are zeros.
        let word = words
            .get(next)
            .map_or(0, |w| u32::from(u16::from_le_bytes(*w)));
        let needs = new < LOW;
        *x = if needs { new << 16 | word } else { new };
        next += usize::from(needs);
        slot.symbol
    };
    if step == 1 {
        let (fours, last) = out.as_chunks_mut::<STATES>();
        for four in fours {
            for (x, o) in states.iter_mut().zip(four) {
                *o = take(x);
            }
        }
        for (x, o) in states.iter_mut().zip(last) {
            *o = take(x);
        }
    } else {
        for (i, o) in out.iter_mut().step_by(step).enumerate() {
            *o = take(&mut states[i % STATES]);
        }
    }
    (next == words.len() && states == [LOW; STATES]).then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(seed: &mut u64) -> u64 {
        *seed ^= *seed << 13;
        *seed ^= *seed >> 7;
        *seed ^= *seed << 17;
        *seed
    }

    /// Bytes of many distributions: even, steep, two values, one value, one exception.
    fn planes() -> Vec<Vec<u8>> {
        let mut seed = 7;
        let mut all = Vec::new();
        for n in [1, 3, 512, 4096, 4099] {
            for steep in 0..9 {
                let byte =
                    |r: u64| ((r & 0xff) >> steep) as u8 & (r >> 8) as u8 | u8::from(r >> 60 == 0);
                all.push((0..n).map(|_| byte(random(&mut seed))).collect());
            }
            all.push(vec![9; n]);
            all.push((0..n).map(|i| u8::from(i == n / 2) * 255).collect());
            all.push((0..n).map(|i| i as u8).collect());
            all.push((0..n).map(|_| random(&mut seed) as u8).collect());
        }
        all
    }

    #[test]
    fn planes_come_back_and_take_what_their_entropy_says() {
        let mut words = Vec::new();
        for plane in planes() {
            for step in [1, 2] {
                let spread: Vec<u8> = plane.iter().flat_map(|&b| vec![b; step]).collect();
                let mut stored = vec![1, 2, 3];
                encode(
                    &spread[..spread.len() + 1 - step],
                    step,
                    &mut words,
                    &mut stored,
                );
                let mut rest = &stored[3..];
                let mut back = vec![0; spread.len() + 1 - step];
                decode(&mut rest, step, &mut back).expect("decodes");
                assert!(rest.is_empty());
                assert!(back.iter().step_by(step).eq(&plane));
                let n = plane.len() as f64;
                let mut counts = [0.0; 256];
                plane.iter().for_each(|&b| counts[usize::from(b)] += 1.0);
                let used = counts.iter().filter(|&&c| c > 0.0).count() as f64;
                let entropy: f64 = counts
                    .iter()
                    .filter(|&&c| c > 0.0)
                    .map(|c| -c * (c / n).log2())
                    .sum();
                let most = (1.03 * entropy / 8.0 + 3.0 * used + 30.0)
                    .min(n + 1.0)
                    .max(2.0);
                let took = (stored.len() - 3) as f64;
                assert!(took <= most, "{took} bytes for {n}, {most} expected");
            }
        }
    }

    #[test]
    fn changed_streams_are_refused_or_decode_to_something() {
        let mut words = Vec::new();
        let mut seed = 5;
        let mut out = vec![0; 512];
        for plane in planes().into_iter().filter(|p| p.len() == 512) {
            let mut stored = Vec::new();
            encode(&plane, 1, &mut words, &mut stored);
            for cut in 0..stored.len() {
                assert!(decode(&mut &stored[..cut], 1, &mut out).is_none());
            }
            for _ in 0..2000 {
                let mut bad = stored.clone();
                let at = random(&mut seed) as usize % bad.len();
                bad[at] ^= 1 << (random(&mut seed) % 8);
                let mut rest = &bad[..];
                let _ = decode(&mut rest, 1, &mut out);
            }
        }
    }
}

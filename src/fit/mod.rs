//! Fitting primitives to a picture: float, stochastic, seeded; the same result for any thread count.

pub(crate) mod adam;
pub(crate) mod descend;
pub(crate) mod field;
pub(crate) mod kernel;
pub(crate) mod project;
pub(crate) mod rates;
pub(crate) mod relocate;
pub(crate) mod sample;
pub(crate) mod target;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::gaussian::Blend;
use crate::pixels::Pixels;
use adam::{Bounds, Memory, Rates};
use field::{Field, Output, RowSet, Scene};
use project::{Primitive, Projected};
use target::Target;

/// LAB
pub fn lab(pixels: &Pixels, n: usize, iters: u32, stride: u32) {
    let env = |k: &str, d: f32| std::env::var(k).ok().map_or(d, |v| v.parse().unwrap());
    let t0 = std::time::Instant::now();
    let target = Target::new(pixels);
    let scene =
        Scene { width: target.width, height: target.height, blend: Blend::Normalized, background: target.mean };
    let mut rng = Pcg64Mcg::seed_from_u64(env("SEED", 0.0) as u64);
    let mut prims = sample::by_detail(&target, n, &mut rng);
    let mut mem = vec![Memory::default(); n];
    let bounds = Bounds::new(target.width, target.height);
    for p in &mut prims { bounds.apply(p); }
    let mut field = Field::default();
    let area = f64::from(target.width) * f64::from(target.height) * 3.0;
    let mut phase0 = 0u32;
    let strided = (env("SFRAC", 0.75) * iters as f32) as u32;
    eprintln!("init {:?}", t0.elapsed());
    let (mut tp, mut td, mut ts, mut tr) = (0.0, 0.0, 0.0, 0.0);
    let sort = |prims: &mut Vec<Primitive>, mem: &mut Vec<Memory>| {
        let mut ix: Vec<usize> = (0..prims.len()).collect();
        ix.sort_by_key(|&i| ((prims[i].mean[1] / 16.0) as u32, prims[i].mean[0] as u32));
        *prims = ix.iter().map(|&i| prims[i]).collect();
        *mem = ix.iter().map(|&i| mem[i]).collect();
    };
    sort(&mut prims, &mut mem);
    let relk = env("RELK", 40.0) as u32;
    for it in 0..iters {
        if it > 0 && it % relk == 0 && (it as f32) < env("RELEND", 0.7) * iters as f32 {
            let t = std::time::Instant::now();
            let m = relocate::relocate(&scene, &target, &mut field, RowSet::ALL, &mut prims, &mut mem, (n as f32 * env("RELF", 0.03)) as usize);
            sort(&mut prims, &mut mem);
            if env("LOG", 0.0) > 0.0 { eprintln!("it {it} moved {m}"); }
            tr += t.elapsed().as_secs_f64();
        }
        let rows = if it < strided && stride > 1 {
            let m = it % stride;
            if m == 0 { phase0 = rng.random::<u32>() & 0xffff; }
            RowSet { step: stride, phase: (m * (if stride > 2 { stride / 2 + 1 } else { 1 }) + phase0) % stride }
        } else { RowSet::ALL };
        let t = std::time::Instant::now();
        let projected = crate::parallel::map(prims.len().div_ceil(256), |c| prims[c*256..prims.len().min(c*256+256)].iter().map(|p| Projected::new(p, scene.height)).collect::<Vec<_>>()).concat();
        tp += t.elapsed().as_secs_f64();
        let t = std::time::Instant::now();
        field.draw(&scene, &target, &projected, rows, Output::Gradient);
        td += t.elapsed().as_secs_f64();
        let t = std::time::Instant::now();
        let f = it as f32 / iters as f32;
        let lf = 0.02;
        let sc = lf + (1.0 - lf) * 0.5 * (1.0 + (std::f32::consts::PI * f).cos());
        let lr = env("LR", 0.1);
        let rates = Rates { mean: lr, log_scale: lr, rotation: lr, color: env("LRC", 0.01) }.scaled(sc);
        adam::step(&scene, 3, &field, rows, &projected, &mut prims, &mut mem, None, &bounds, rates, it);
        ts += t.elapsed().as_secs_f64();
        if env("LOG", 0.0) > 0.0 && (it % 40 == 39 || it < 8) { let m: f32 = prims.iter().map(|p| p.log_scale[0]+p.log_scale[1]).sum::<f32>() / 2.0 / n as f32; eprintln!("mean log scale {m} {:?}", prims[n/2]);
            let projected: Vec<_> = prims.iter().map(|p| Projected::new(p, scene.height)).collect();
            let e = field.draw(&scene, &target, &projected, RowSet::ALL, Output::Gradient);
            eprintln!("it {it} psnr {:.3}", -10.0 * (e / area).log10());
        }
    }
    let projected: Vec<_> = prims.iter().map(|p| Projected::new(p, scene.height)).collect();
    let e = field.draw(&scene, &target, &projected, RowSet::ALL, Output::Gradient);
    println!("n {n} iters {iters} psnr {:.3} in {:.2?}: project {tp:.2} draw {td:.2} step {ts:.2} relocate {tr:.2}", -10.0 * (e / area).log10(), t0.elapsed());
    use crate::bitstream::splats::*;
    let steps = Steps { scale: env("SS", 2.0) as u8, angle: env("SA", 1.0) as u8, position: env("SP", 5.0) as u8, coarsest: env("SE", 3.0) as i8, range: 8, luma: env("SL", 6.0) as u8, chroma: env("SC", 1.0) as u8 };
    let q = crate::quantize::Quantizer::new(&steps, Layout::Coded, [scene.width, scene.height], target.channels);
    let mut packed: Vec<PackedGaussian> = prims.iter().map(|p| q.quantize(&p.to_gaussian())).collect();
    let psnr = |packed: &[PackedGaussian], field: &mut Field| { let pr: Vec<_> = packed.iter().map(|g| Projected::from_gaussian(&q.dequantize(g), scene.height)).collect(); let e = field.draw(&scene, &target, &pr, RowSet::ALL, Output::Gradient); (-10.0 * (e / area).log10(), e) };
    let bits = |packed: &[PackedGaussian]| { let r = rates::Rates::measure(packed, 3); let a = f64::from(scene.width) * f64::from(scene.height); let b: f64 = packed.iter().map(|g| f64::from(r.geometry(g, q.lattice()) + r.colors(g.color))).sum(); let n = packed.len() as f64; b / n + (a / n).log2() + 1.44 };
    let (p0, e0) = psnr(&packed, &mut field);
    println!("raw quantized {p0:.3} bits/prim {:.2}", bits(&packed));
    let lam = env("LAM", 0.7) * (e0 / (n as f64 * 35.0)) as f32;
    for i in 0..env("SWEEPS", 6.0) as u32 {
        let t = std::time::Instant::now();
        let sw = descend::sweep(&scene, &target, &q, &mut packed, &descend::Objective { lambda: lam, position_bits: f32::NEG_INFINITY }, &mut field);
        let dt = t.elapsed();
        let (p, e) = psnr(&packed, &mut field);
        let b = bits(&packed);
        println!("sweep {i} psnr {p:.3} e {e:.2} bits/prim {b:.2} bytes {:.0} {sw:?} {dt:?}", b * packed.len() as f64 / 8.0);
    }
}
#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn dbg() {
        let p = Primitive { mean: [20.3, 17.2], log_scale: [2f32.ln(), 4f32.ln()], rotation: 0.5, color: [1.0, 0.5, 0.2, 0.0] };
        let q = Projected::new(&p, 64);
        eprintln!("{q:?}");
        let e = kernel::exp2(kernel::lanes(|i| -(i as f32) * 0.7));
        for i in 0..16 { eprintln!("{} {}", e[i], (-(i as f32) * 0.7).exp2()); }
        for y in q.rows[0]..q.rows[1] { eprintln!("{y} {:?}", q.span(y, 64)); }
    }
}
#[cfg(test)]
mod fd {
    use super::*;
    use crate::pixels::Samples;
    use crate::gaussian::Channels;
    #[test]
    fn fd() {
        let (w, h) = (48u32, 40u32);
        let px = Pixels::new(w, h, Channels::Rgb, Samples::U8((0..w * h * 3).map(|i| (60 + (i * 7919) % 97) as u8).collect())).unwrap();
        let t = Target::new(&px);
        let scene = Scene { width: w, height: h, blend: Blend::Normalized, background: t.mean };
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut prims = sample::by_detail(&t, 30, &mut rng);
        for p in &mut prims { p.log_scale[0] += 0.3; p.log_scale[1] -= 0.2; }
        let mut f = Field::default();
        let proj: Vec<_> = prims.iter().map(|p| Projected::new(p, h)).collect();
        f.draw(&scene, &t, &proj, RowSet::ALL, Output::Gradient);
        let g: Vec<_> = (0..30).map(|i| field::gather::<3>(&f, RowSet::ALL, w, &proj[i], prims[i].log_scale, prims[i].rotation)).collect();
        let mut f2 = Field::default();
        let mut loss = |pr: &[Primitive]| { let q: Vec<_> = pr.iter().map(|p| Projected::new(p, h)).collect(); 0.5 * f2.draw(&scene, &t, &q, RowSet::ALL, Output::Picture) };
        for i in [3, 11, 20] {
            for j in 0..6 {
                let ep = 1e-2f32;
                let mv = |s: f32| { let mut q = prims.clone(); let p = &mut q[i]; let [sx, sy] = p.log_scale.map(f32::exp); let (sn, cs) = p.rotation.sin_cos();
                    match j { 0 => { p.mean[0] += cs * s * sx; p.mean[1] += sn * s * sx } 1 => { p.mean[0] -= sn * s * sy; p.mean[1] += cs * s * sy } 2 => p.log_scale[0] += s, 3 => p.log_scale[1] += s, 4 => p.rotation += s, _ => p.color[1] += s }; q };
                let d = (loss(&mv(ep)) - loss(&mv(-ep))) / (2.0 * f64::from(ep));
                let a = [g[i].mean[0], g[i].mean[1], g[i].log_scale[0], g[i].log_scale[1], g[i].rotation, g[i].color[1]][j];
                eprintln!("{i} {j} fd {d:.5} analytic {a:.5}");
            }
        }
    }
}

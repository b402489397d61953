fn main() {
    let a: Vec<String> = std::env::args().collect();
    let im = image::open(&a[1]).unwrap().to_rgb8();
    let (w, h) = im.dimensions();
    let px = ssplat::Pixels::new(w, h, ssplat::Channels::Rgb, ssplat::Samples::U8(im.into_raw())).unwrap();
    ssplat::fit::lab(&px, a[2].parse().unwrap(), a[3].parse().unwrap(), a[4].parse().unwrap());
}

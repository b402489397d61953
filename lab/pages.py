#!/usr/bin/env python3
"""Makes pictures of pages and screens with Chromium, to measure the encoder on.

    python lab/pages.py PHOTOGRAPHS FOLDER
    python lab/screens.py target/release/ssplat FOLDER

PHOTOGRAPHS is a folder with at least six photographs. The command writes these pictures into FOLDER: an article with two
photographs, a dashboard, a program in an editor, a gallery, a table, a chat, a slide, a desktop with a photograph behind
its windows, a manual, and a shop at two pixels for each pixel of the page; and three scans of these pages, with noise.
FOLDER/alpha gets pictures with alpha: a badge and a menu with soft shadows, a sheet of sprites, a card with a photograph,
a photograph with soft edges and letters on it, and a photograph with soft edges that keeps its colours under alpha 0.
The text is that of the documents of this repository. Which fonts are installed, and the version of Chromium, change the
pictures a little.
"""
import argparse, html, math, pathlib, random, re, subprocess, tempfile

import numpy
from PIL import Image, ImageDraw, ImageFilter

root = pathlib.Path(__file__).resolve().parent.parent
STYLE = "<!doctype html><meta charset=utf-8><style>*{box-sizing:border-box}body{margin:0;font:16px/1.5 'DejaVu Sans'}img{display:block}%s</style>%s"


def text(words, start=0, name="README.md"):
    """Returns some words of a document, as HTML."""
    found = [w for w in (root / name).read_text().split() if not set(w) & set("`|#<>*[](){}_/\\")]
    return html.escape(" ".join(found[start:start + words]))


def article(photos):
    return (1000, 1400, 1), "body{font:18px/1.6 'DejaVu Serif';padding:40px 120px;color:#222}h1{font-size:40px}img{width:100%;height:340px;object-fit:cover}small{color:#777}", (
        f"<h1>{text(6, 40)}</h1><p>{text(70)}<p><img src='{photos[0]}'><small>{text(12, 90)}</small><p>{text(90, 120)}<p><img src='{photos[1]}'><p>{text(60, 230)}")


def dashboard(_):
    numbers = random.Random(1)
    cards = "".join(f"<div class=c><small>{text(2, 3 * k)}</small><b>{numbers.randrange(100, 99999):,}</b><i style='width:{numbers.randrange(20, 90)}%'></i></div>" for k in range(8))
    lines = ""
    for color in ("#4e9af1", "#f1784e", "#56d364"):
        y, points = 120.0, []
        for x in range(0, 1160, 12):
            y = min(230, max(10, y + numbers.uniform(-22, 22)))
            points.append(f"{x},{y:.1f}")
        lines += f"<polyline points='{' '.join(points)}' fill=none stroke='{color}' stroke-width=2 />"
    grid = "".join(f"<path d='M0 {y}H1160' stroke='#30363d'/>" for y in range(0, 260, 40))
    return (1280, 800, 1), "body{background:#0d1117;color:#c9d1d9;padding:24px}.g{display:grid;grid-template-columns:repeat(4,1fr);gap:16px}.c{background:#161b22;border:1px solid #30363d;border-radius:8px;padding:16px;box-shadow:0 4px 12px #0008}.c b{display:block;font-size:28px}.c i{display:block;height:6px;border-radius:3px;background:linear-gradient(90deg,#1f6feb,#a371f7)}svg{margin-top:24px;background:#161b22;border-radius:8px}", (
        f"<h2>{text(3, 9)}</h2><div class=g>{cards}</div><svg width=1230 height=280 viewBox='-20 -10 1200 270'>{grid}{lines}</svg>")


def editor(_):
    colors = {"fn": "#c678dd", "let": "#c678dd", "pub": "#c678dd", "use": "#c678dd", "for": "#c678dd", "if": "#c678dd", "self": "#e06c75", "u64": "#e5c07b", "usize": "#e5c07b", "Result": "#e5c07b"}
    rows = []
    for number, line in enumerate((root / "src/bitstream/exact/colors.rs").read_text().splitlines()[:46], 1):
        words = "".join(f"<span style='color:{colors[w]}'>{w}</span>" if w in colors else html.escape(w) for w in re.split(r"(\W)", line))
        if line.strip().startswith("//"):
            words = f"<span style='color:#7f848e'>{html.escape(line)}</span>"
        rows.append(f"<span style='color:#495162'>{number:4}  </span>{words}")
    files = "".join(f"<div>{name.name}</div>" for name in sorted((root / "src").iterdir()))
    return (1280, 900, 1), "body{background:#282c34;color:#abb2bf;display:flex}nav{width:220px;background:#21252b;padding:12px;font-size:13px}pre{font:13px/19px 'DejaVu Sans Mono';margin:0;padding:8px}", f"<nav>{files}</nav><pre>{chr(10).join(rows)}</pre>"


def gallery(photos):
    return (1200, 1000, 1), "body{background:#fff;padding:30px}.g{display:grid;grid-template-columns:repeat(3,1fr);gap:20px}img{width:100%;height:260px;object-fit:cover;border-radius:10px}", (
        f"<h1>{text(3, 5)}</h1><div class=g>" + "".join(f"<figure style='margin:0'><img src='{p}'><figcaption>{text(7, 11 * k)}</figcaption></figure>" for k, p in enumerate(photos[:6])) + "</div>")


def table(_):
    numbers = random.Random(2)
    rows = "".join("<tr>" + f"<th>{text(2, 5 * y)}</th>" + "".join(f"<td style='background:hsl({120 * v},70%,{92 - 25 * abs(v - .5):.0f}%)'>{1000 * v:.2f}</td>" for v in (numbers.random() for _ in range(12))) for y in range(30))
    return (1280, 860, 1), "table{border-collapse:collapse;font-size:13px}td,th{border:1px solid #d0d0d0;padding:2px 8px;text-align:right;white-space:nowrap}", f"<table>{rows}</table>"


def chat(photos):
    rows = "".join(f"<div style='display:flex;gap:12px;margin:10px {20 + 300 * (k % 2)}px'><img src='{photos[k % 6]}' width=44 height=44 style='border-radius:22px;object-fit:cover'><div style='background:{'#dcf8c6' if k % 2 else '#fff'};border-radius:12px;padding:8px 14px;max-width:440px;box-shadow:0 1px 2px #0003'>{text(6 + 5 * k % 23, 17 * k)}</div></div>" for k in range(10))
    return (900, 1000, 1), "body{background:#e5ddd5 linear-gradient(160deg,#e5ddd5,#cfd9df)}", rows


def slide(photos):
    return (1600, 900, 1), "body{background:linear-gradient(135deg,#1d2b64,#f8cdda);color:#fff;padding:80px;font-size:30px}h1{font-size:84px;margin:0 0 40px}img{position:absolute;right:80px;bottom:80px;width:560px;height:420px;object-fit:cover;border-radius:24px;box-shadow:0 20px 60px #0008}", (
        f"<h1>{text(3, 30)}</h1><ul style='width:760px'>" + "".join(f"<li>{text(9, 20 + 13 * k)}" for k in range(5)) + f"</ul><img src='{photos[2]}'>")


def desktop(photos):
    window = "<div style='position:absolute;left:{0}px;top:{1}px;width:{2}px;height:{3}px;background:#fafafa;border-radius:8px;box-shadow:0 10px 40px #000a;overflow:hidden'><div style='background:#dedede;padding:4px 12px;font-size:13px'>{4}</div><div style='padding:12px;font-size:14px'>{5}</div></div>"
    return (1440, 900, 1), f"body{{background:url('{photos[3]}') center/cover}}", (
        window.format(120, 90, 620, 480, text(3, 12), text(170, 30)) + window.format(640, 320, 600, 460, text(3, 50), text(150, 90))
        + "<div style='position:absolute;left:0;right:0;top:0;height:28px;background:#000b;color:#fff;font-size:14px;padding:2px 16px'>File Edit View Window Help</div>")


def manual(_):
    return (1100, 1300, 1), "body{padding:30px 60px;color:#1f2328}code,pre{background:#f6f8fa;font:13px 'DejaVu Sans Mono';padding:2px 4px}pre{padding:14px;border-radius:6px}a{color:#0969da}h2{border-bottom:1px solid #d1d9e0}", "".join(
        f"<h2>{text(4, 30 * k)}</h2><p>{text(45, 40 * k)} <a href=x>{text(4, 9 * k)}</a> {text(12, 50 * k)}<pre>ssplat encode picture{k}.png --ratio {10 * k + 20}\nssplat decode picture{k}.ssplat out.png</pre>" for k in range(5))


def shop(photos):
    cards = "".join(f"<div style='background:#fff;border:1px solid #ddd;border-radius:6px;padding:10px'><img src='{photos[k % 6]}' width=100% height=150 style='object-fit:contain;background:#fff'><b>{text(3, 7 * k)}</b><p style='font-size:12px;margin:4px 0'>{text(14, 11 * k)}<p style='color:#b12704;margin:0'>${19 + 13 * k}.99 <span style='color:#f5a623'>{'★' * (3 + k % 3)}</span></div>" for k in range(6))
    return (720, 640, 2), "body{background:#eaeded}.g{display:grid;grid-template-columns:repeat(3,1fr);gap:12px;padding:14px}", f"<div style='background:#131921;color:#fff;padding:10px 20px'>{text(3, 2)}</div><div class=g>{cards}</div>"


def badge(_):
    return (420, 420, 1), "body{padding:40px}.b{width:320px;height:320px;border-radius:50%;background:linear-gradient(160deg,#3b82f6,#7c3aed);box-shadow:0 16px 40px #0009;color:#fff;font:bold 64px/320px 'DejaVu Sans';text-align:center;border:10px solid #fff}", "<div class=b>ssplat</div>"


def menu(_):
    rows = "".join(f"<div style='padding:7px 18px;display:flex;justify-content:space-between'><span>{text(3, 13 * k)}</span><span style='color:#888'>Ctrl+{chr(65 + k)}</span></div>" for k in range(10))
    return (480, 520, 1), "body{padding:40px}.m{background:#fffffff0;border-radius:10px;border:1px solid #0003;box-shadow:0 12px 40px #0008;font-size:14px}", f"<div class=m>{rows}</div>"


def sprites(_):
    numbers = random.Random(4)
    def sprite(k):
        a, b = f"hsl({37 * k},80%,55%)", f"hsl({37 * k + 60},70%,30%)"
        corners = " ".join(f"{32 + 28 * numbers.uniform(.5, 1) * math.cos(v * math.tau / 9):.1f},{32 + 28 * numbers.uniform(.5, 1) * math.sin(v * math.tau / 9):.1f}" for v in range(9))
        return f"<svg width=64 height=64 viewBox='0 0 64 64'><polygon points='{corners}' fill='{a}' stroke='{b}' stroke-width=3 /><circle cx={numbers.randrange(20, 44)} cy={numbers.randrange(20, 44)} r=9 fill='#fff' stroke='{b}' stroke-width=2 /><circle cx=32 cy=32 r=4 fill='#000'/></svg>"
    return (640, 512, 1), "body{display:grid;grid-template-columns:repeat(10,64px)}", "".join(map(sprite, range(80)))


def card(photos):
    return (520, 640, 1), "body{padding:50px}.c{background:#fff;border-radius:22px;overflow:hidden;box-shadow:0 18px 50px #0009}img{width:100%;height:280px;object-fit:cover}div div{padding:20px}", (
        f"<div class=c><img src='{photos[1]}'><div><b>{text(4, 60)}</b><p>{text(34, 70)}</div></div>")


def poster(photos):
    return (720, 480, 1), "body{position:relative}img{width:720px;height:480px;object-fit:cover;-webkit-mask-image:radial-gradient(closest-side,#000 75%,#0000 98%)}p{position:absolute;left:60px;top:150px;margin:0;font:bold 56px 'DejaVu Sans';color:#fff;text-shadow:0 4px 12px #000}", (
        f"<img src='{photos[4]}'><p>{text(3, 30)}</p>")


# Scans: name, page, size, whether they are grey, radius of the blur, and standard deviation of the noise.
SCANS = [("grey", "manual.png", (900, 700), True, 0.5, 2.5), ("colour", "manual.png", (900, 700), False, 0.6, 2), ("photograph", "article.png", (1000, 900), False, 0.5, 2)]


def scan(page, is_grey, blur, noise):
    """Returns a page as a scanner would show it: white is 245 and black 20."""
    values = 20 + numpy.asarray(page.filter(ImageFilter.GaussianBlur(blur)), float) * 225 / 255
    values = values.mean(-1) if is_grey else values
    values += numpy.random.default_rng(3).normal(0, noise, values.shape)
    return Image.fromarray(values.round().clip(0, 255).astype(numpy.uint8))


def cutout(photo):
    """Returns a photograph with soft edges, with its colours under alpha 0."""
    picture = Image.open(photo).convert("RGB")
    alpha = Image.new("L", picture.size)
    ImageDraw.Draw(alpha).ellipse([side * share for share in (0.12, 0.88) for side in picture.size], fill=255)
    picture.putalpha(alpha.filter(ImageFilter.GaussianBlur(6)).point(lambda v: 0 if v < 3 else v))
    return picture


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--chromium", default="chromium")
    args = parser.parse_args()
    photos = [path.resolve().as_uri() for path in sorted(args.photographs.iterdir()) if path.suffix in (".png", ".jpg")]
    if len(photos) < 6:
        parser.error(f"{args.photographs} has {len(photos)} photographs, 6 are needed")
    args.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        opaque, with_alpha = (article, dashboard, editor, gallery, table, chat, slide, desktop, manual, shop), (badge, menu, sprites, card, poster)
        (args.folder / "alpha").mkdir(exist_ok=True)
        for page in (*opaque, *with_alpha):
            (width, height, scale), style, body = page(photos)
            source = pathlib.Path(folder, "page.html")
            source.write_text(STYLE % (style, body))
            out = args.folder / ("alpha" if page in with_alpha else "") / f"{page.__name__}.png"
            ground = ["--default-background-color=00000000"] if page in with_alpha else []
            subprocess.run([args.chromium, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--allow-file-access-from-files", f"--user-data-dir={folder}/profile",
                            f"--window-size={width},{height}", f"--force-device-scale-factor={scale}", *ground, f"--screenshot={out.resolve()}", source.as_uri()], check=True, capture_output=True, timeout=120)
            print(out)
    out = args.folder / "alpha" / "cutout.png"
    cutout(sorted(p for p in args.photographs.iterdir() if p.suffix in (".png", ".jpg"))[3]).save(out)
    print(out)
    for name, page, size, is_grey, blur, noise in SCANS:
        out = args.folder / f"scan-{name}.png"
        scan(Image.open(args.folder / page).convert("RGB").crop((0, 0, *size)), is_grey, blur, noise).save(out)
        print(out)


if __name__ == "__main__":
    main()

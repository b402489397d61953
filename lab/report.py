"""Tables and charts of docs/BENCHMARKS.md."""
import math, os, platform, re, subprocess, sys, time

COLORS = {"ssplat": "#c2185b", "JPEG": "#9e9e9e", "WebP": "#7cb342", "AVIF tune=iq": "#1565c0", "JPEG XL": "#ff9800", "VVC": "#6a1b9a"}


def number(value, digits):
    if value != value:
        return "–"
    text = f"{value:.{digits}f}"
    return text.replace("-", "−").replace("−0.", "−.") if text.startswith("-0.") else text.replace("0.", ".", 1) if text.startswith("0.") else text.replace("-", "−")


def signed(value, digits):
    """A difference, with its sign unless it is 0 in these digits."""
    if float(f"{value:.{digits}f}") == 0:
        return number(0.0, digits)
    text = number(value, digits)
    return text if text[0] in "−–" else f"+{text}"


def table(head, rows, left=1):
    lines = ["| " + " | ".join(head) + " |", "|" + "".join("---|" if i < left else "--:|" for i in range(len(head)))]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def commit_of(root):
    return subprocess.run(["git", "log", "-1", "--format=%h"], cwd=root, capture_output=True, text=True).stdout.strip()


def measured_when(commit):
    """The sentence with the date, the commit and the machine of a run."""
    processor = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), platform.machine())
    return f"Measured on {time.strftime('%d %B %Y').lstrip('0')} with commit {commit}, on {os.cpu_count()} cores of {processor}."


def write_tables(page, tables):
    """Replaces the lines between the comments `<!-- NAME -->` and `<!-- end -->` of a page."""
    text = page.read_text()
    for name, made in tables.items():
        text, count = re.subn(rf"(<!-- {name} -->\n).*?(<!-- end -->)", lambda match: match.group(1) + made + "\n" + match.group(2), text, flags=re.S)
        if not count:
            print(f"no place for the table {name} in {page}", file=sys.stderr)
    page.write_text(text)


def opened(width, height):
    return [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">', f'<rect width="{width}" height="{height}" fill="white"/>']


def thickness(name):
    return 3 if name == "ssplat" else 1.6


def plot(edges, lines, across, up):
    """Draws the grid, the numbers of both axes and the curves between the left, right, upper and lower edge."""
    (left, right, top, bottom), (low, high, marks), (least, most, apart) = edges, across, up
    px = lambda x: left + (right - left) * math.log(x / low) / math.log(high / low)
    py = lambda y: bottom - (bottom - top) * (y - least) / (most - least)
    out = []
    for y in range(int(least), int(most) + 1, apart):
        out.append(f'<line x1="{left}" x2="{right}" y1="{py(y):.1f}" y2="{py(y):.1f}" stroke="#e0e0e0"/><text x="{left - 8}" y="{py(y) + 4:.1f}" text-anchor="end">{y}</text>')
    for x in marks:
        out.append(f'<line x1="{px(x):.1f}" x2="{px(x):.1f}" y1="{top}" y2="{bottom}" stroke="#e0e0e0"/><text x="{px(x):.1f}" y="{bottom + 18}" text-anchor="middle">{x}</text>')
    curves = []
    for name, line in lines.items():
        inside = sorted((x, y) for x, y in line if low <= x <= high and y >= least)
        thick = thickness(name)
        curves.append(f'<polyline fill="none" stroke="{COLORS[name]}" stroke-width="{thick}" points="{" ".join(f"{px(x):.1f},{py(y):.1f}" for x, y in inside)}"/>')
        curves.extend(f'<circle cx="{px(x):.1f}" cy="{py(y):.1f}" r="{thick}" fill="{COLORS[name]}"/>' for x, y in inside)
    return out, curves


def axis_titles(across, up, middle, left, bottom):
    x, y = middle
    return [f'<text x="{x}" y="{bottom}" text-anchor="middle">{across}</text>', f'<text transform="translate({left} {y}) rotate(-90)" text-anchor="middle">{up}</text>']


def legend(names, x, top):
    out = []
    for i, name in enumerate(names):
        y = top + 16 + 20 * i
        out.append(f'<line x1="{x}" x2="{x + 24}" y1="{y}" y2="{y}" stroke="{COLORS[name]}" stroke-width="{thickness(name)}"/><text x="{x + 30}" y="{y + 4}">{name}</text>')
    return out


def svg(lines, across, up):
    """Plots curves over a logarithmic axis. Takes the ends, ticks and label of that axis, and the ends and tick distance
    of the vertical one."""
    width, height, left, bottom, top, right = 760, 430, 56, 46, 14, 150
    *axis, title = across
    grid, curves = plot((left, width - right, top, height - bottom), lines, axis, up)
    titles = axis_titles(title, "SSIMULACRA2", ((left + width - right) / 2, (top + height - bottom) / 2), 14, height - 8)
    return "\n".join([*opened(width, height), *grid, *titles, *curves, *legend(lines, width - right + 14, top), "</svg>"]) + "\n"


def multiples(panels, across, up):
    """Plots small charts in rows of two with the same axes, each with its title: {title: {name: [(x, y)]}}."""
    width, height, left, top, apart_x, apart_y, right, foot = 300, 205, 56, 30, 50, 54, 150, 46
    *axis, title = across
    rows, names, out = (len(panels) + 1) // 2, list(dict.fromkeys(name for lines in panels.values() for name in lines)), []
    whole = left + 2 * width + apart_x + right, top + rows * height + (rows - 1) * apart_y + foot
    for i, (name, lines) in enumerate(panels.items()):
        x, y = left + i % 2 * (width + apart_x), top + i // 2 * (height + apart_y)
        grid, curves = plot((x, x + width, y, y + height), lines, axis, up)
        out += [f'<text x="{x}" y="{y - 8}" font-weight="bold">{name}</text>', *grid, *curves]
    out += axis_titles(title, "SSIMULACRA2", (left + width + apart_x / 2, (top + whole[1] - foot) / 2), 14, whole[1] - 8)
    return "\n".join([*opened(*whole), *out, *legend(names, whole[0] - right + 14, top), "</svg>"]) + "\n"

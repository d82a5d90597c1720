//! Mistakes with cameras and files of other kinds: shapes of openings, micro-images that overlap, a tilted lens, boards that
//! fill the view, dark images, pages, raw data, formats that are not read.

use crate::Expected::{Refused, Right, Told, Warned};
use crate::set::Set;
use crate::{Expected, Mistake, mistake};

pub fn mistakes() -> Vec<Mistake> {
    [openings(), optics(), boards(), dark(), pages(), formats()].into_iter().flatten().collect()
}

/// A simulated set with other settings, which its project knows nothing of, and these changes of the project.
fn shot(
    name: &str,
    expected: Expected,
    settings: &'static [&'static str],
    change: fn(Set) -> Set,
) -> Mistake {
    mistake(name, expected, move || {
        let arguments: Vec<&str> = settings.iter().flat_map(|s| ["--set", *s]).collect();
        change(Set::of(&arguments))
    })
}

/// `mini` with more lines in `[images]`.
fn images(name: &str, lines: &'static str, expected: Expected) -> Mistake {
    mistake(name, expected, move || with_images(Set::mini(), lines))
}

fn with_images(set: Set, lines: &str) -> Set {
    let line = "devignetting = \"devignetting.png\"\n";
    set.text(line, &format!("{line}{lines}\n"))
}

fn with_array(set: Set, line: &str) -> Set {
    set.text("lens_types = 3\n", &format!("lens_types = 3\n{line}\n"))
}

const CELLS: &[&str] = &["imperfections.opening=hexagon", "rays=64", "seed=9941"];

fn openings() -> Vec<Mistake> {
    let stated = |name: &str, line: &'static str, expected| {
        mistake(name, expected, move || with_array(Set::mini(), line))
    };
    let named = Warned(&["openings of the micro-lenses"]);
    vec![
        stated("opening: discs stated as hexagons", "opening = \"hexagon\"", named),
        stated("opening: discs stated as discs", "opening = \"disc\"", Right),
        stated(
            "opening: squares in a hexagonal lattice",
            "opening = \"square\"",
            Refused(&["square"]),
        ),
        stated("opening: no shape", "opening = \"octagon\"", Refused(&["octagon"])),
        stated("opening: a number", "opening = 6", Refused(&["opening"])),
        shot("opening: hexagons, not stated", Right, CELLS, |set| set),
        shot("opening: hexagons stated as discs", named, CELLS, |set| {
            with_array(set, "opening = \"disc\"")
        }),
    ]
}

fn optics() -> Vec<Mistake> {
    let tilted: &[&str] = &["camera.main_lens.rotation_rad=[0.007, 0.004]", "rays=32", "seed=9942"];
    vec![
        shot("lens tilted by 8 mrad", Right, tilted, |set| set),
        shot("lens tilted by 8 mrad, without its tilt", Right, tilted, |set| {
            set.more("[calibration]\nlens_tilt = \"none\"")
        }),
        shot(
            "micro-images overlap by a tenth",
            Right,
            &[
                "camera.main_lens.f_number=3.4",
                "white_images.f_numbers=[3.4,4.8,6.8,9.6,13.6]",
                "rays=32",
                "seed=9943",
            ],
            |set| set,
        ),
        shot(
            "micro-images overlap by a third",
            Told(&["overlap", "f-number"]),
            &[
                "camera.main_lens.f_number=2.8",
                "white_images.f_numbers=[2.8,4,5.6,8,11.2]",
                "rays=32",
                "seed=9944",
            ],
            |set| set,
        ),
    ]
}

fn boards() -> Vec<Mistake> {
    let filled: &[&str] = &[
        "boards.min_in_view=0.4",
        "boards.max_tilt_deg=25",
        "target.columns=11",
        "target.rows=8",
        "rays=32",
        "seed=9945",
    ];
    vec![
        shot("boards that fill the view", Right, filled, |set| set),
        shot(
            "boards that fill the view, squares too large",
            Warned(&["square_mm"]),
            filled,
            |set| set.value("square_mm", "3.3"),
        ),
    ]
}

/// `mini` with a dark image of zeros.
fn with_black_image(width: u32, height: u32) -> Set {
    let set = Set::mini();
    let image = image::GrayImage::new(width, height);
    image.save(set.path().join("dark.png")).expect("it is written");
    with_images(set, "dark = \"dark.png\"")
}

fn dark() -> Vec<Mistake> {
    let named = Refused(&["dark"]);
    vec![
        images("dark: no such file", "dark = \"dark.png\"", named),
        images("dark: a white image", "dark = \"whites/white-2-n-8.00.png\"", named),
        images("dark: a board", "dark = \"calibration/calibration-00.png\"", named),
        images("dark: a folder", "dark = \"whites\"", Refused(&["folder"])),
        images("dark: a number", "dark = 16", named),
        mistake("dark: a text file", named, move || {
            let set = Set::mini();
            set.write("dark.png", "dark");
            with_images(set, "dark = \"dark.png\"")
        }),
        mistake("dark: another size", named, || with_black_image(500, 400)),
        mistake("dark: nothing but zeros", Right, || with_black_image(1000, 750)),
    ]
}

fn pages() -> Vec<Mistake> {
    vec![
        images("pages: the page 0", "pages = 0", Refused(&["pages"])),
        images("pages: a negative page", "pages = -1", Refused(&["pages"])),
        images("pages: the median", "pages = \"median\"", Refused(&["pages"])),
        images("pages: of files with one page", "pages = 3", Refused(&["page"])),
        images("pages: the mean of one page", "pages = \"average\"", Right),
    ]
}

fn formats() -> Vec<Mistake> {
    let frame = "calibration/calibration-03.png";
    let instead = move |name: &str, file: &'static str, content: &'static [u8], expected| {
        mistake(name, expected, move || {
            let set = Set::mini();
            set.write(file, content);
            set.text(frame, file)
        })
    };
    // The board is left out; the others are right.
    let save = Warned(&["save", "export", "convert"]);
    vec![
        instead("format: a DNG file", "board.dng", b"II*\0\x08\0\0\0", save),
        instead("format: a Lytro file", "board.lfp", b"\x89LFP\r\n\x1a\n\0\0\0\x01", save),
        instead("format: a Raytrix file", "board.ray", b"RAY", save),
        instead("format: an HDF5 file", "board.h5", b"\x89HDF\r\n\x1a\n", save),
        instead("format: a FITS file", "board.fits", b"SIMPLE  =                    T", save),
        instead(
            "format: raw data without a layout",
            "board.raw",
            &[16; 1500],
            Warned(&["[images.raw]"]),
        ),
        mistake("format: raw data with the layout of other data", Warned(&["bytes"]), || {
            let set = Set::mini();
            set.write("board.raw", [16_u8; 1500]);
            let layout = "[images.raw]\npacking = \"Mono8\"";
            set.text(frame, "board.raw").more(layout)
        }),
    ]
}

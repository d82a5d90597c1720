//! Images that a camera, a driver or a program has processed.

use image::{DynamicImage, ImageBuffer, Luma, imageops};

use crate::Expected::{Refused, Right, Told, Warned};
use crate::edits::{Of, changed, grey, jpeg};
use crate::set::Set;
use crate::{Expected, Mistake, mistake, pixels};

/// A change of the grey images of a role.
fn change(
    what: &str,
    of: Of,
    expected: Expected,
    change: impl Fn(&image::GrayImage) -> image::GrayImage + Sync + Clone + 'static,
) -> Mistake {
    mistake(format!("{what}, {}", of.name()), expected, move || {
        grey(Set::mini(), of, change.clone())
    })
}

pub fn mistakes() -> Vec<Mistake> {
    [tones(), compressed(), filtered(), placed(), resized(), marred(), formats()]
        .into_iter()
        .flatten()
        .collect()
}

fn tones() -> Vec<Mistake> {
    let mut all = Vec::new();
    let gamma = Told(&["gamma", "linear"]);
    for (name, value, expected) in [
        ("gamma 1.2", 1.2, gamma),
        ("gamma 1.5", 1.5, gamma),
        ("gamma 1.8", 1.8, gamma),
        ("gamma 2.2", 2.2, gamma),
        ("gamma 0.8", 0.8, gamma),
        ("gamma 0.45", 0.45, gamma),
    ] {
        for of in [Of::All, Of::Boards, Of::Whites] {
            all.push(change(name, of, expected, move |image| pixels::gamma(image, value)));
        }
    }
    let levels = Told(&["black", "level", "linear", "full", "processed"]);
    for (name, add) in
        [("4 grey levels more", 4.0), ("16 grey levels more", 16.0), ("40 grey levels more", 40.0)]
    {
        for of in [Of::All, Of::Boards, Of::Whites] {
            let expected = if of == Of::All { Right } else { levels };
            all.push(change(name, of, expected, move |image| {
                pixels::curve(image, |x| add + x * (255.0 - add) / 255.0)
            }));
        }
    }
    for (name, most) in [("full at 180", 180.0), ("full at 120", 120.0), ("full at 60", 60.0)] {
        for of in [Of::All, Of::Boards, Of::Whites] {
            let expected = if most > 100.0 {
                Right
            } else {
                Told(&["full", "saturated", "exposed", "two discs", "white image"])
            };
            all.push(change(name, of, expected, move |image| {
                pixels::curve(image, |x| x.min(most))
            }));
        }
    }
    for (name, part) in
        [("half as bright", 0.5), ("a tenth as bright", 0.1), ("a hundredth as bright", 0.01)]
    {
        for of in [Of::All, Of::Boards, Of::Whites] {
            let expected =
                if part > 0.05 { Right } else { Told(&["dark", "light", "noise", "f-number"]) };
            all.push(change(name, of, expected, move |image| pixels::curve(image, |x| part * x)));
        }
    }
    for of in [Of::All, Of::Boards, Of::Whites] {
        all.push(change("inverted", of, Refused(&["white", "corners", "micro-images"]), |image| {
            pixels::curve(image, |x| 255.0 - x)
        }));
        all.push(change("black below 20 cut off", of, levels, |image| {
            pixels::curve(image, |x| (x - 20.0).max(0.0))
        }));
        all.push(change(
            "contrast stretched by 1.5 about 128",
            of,
            Told(&["linear", "level", "black"]),
            |image| pixels::curve(image, |x| 128.0 + 1.5 * (x - 128.0)),
        ));
        let coarse = if of == Of::Whites {
            Warned(&["scatter", "linear"])
        } else {
            Warned(&["grey levels"])
        };
        all.push(change("16 grey levels only", of, coarse, |image| {
            pixels::curve(image, |x| (x / 17.0).round() * 17.0)
        }));
    }
    all.push(change("three times as bright", Of::OneBoard, Right, |image| {
        pixels::curve(image, |x| 3.0 * x)
    }));
    all.push(change("dark", Of::OneBoard, Right, |image| pixels::curve(image, |x| 0.02 * x)));
    all
}

fn compressed() -> Vec<Mistake> {
    let mut all = Vec::new();
    for quality in [98, 95, 90, 80, 50, 20] {
        for of in [Of::All, Of::Boards, Of::Whites] {
            all.push(mistake(
                format!("JPEG {quality}, {}", of.name()),
                Told(&["JPEG"]),
                move || jpeg(Set::mini(), of, quality),
            ));
        }
    }
    all
}

fn filtered() -> Vec<Mistake> {
    let mut all = Vec::new();
    for (name, std_dev) in
        [("blurred by 0.5 px", 0.5), ("blurred by 1 px", 1.0), ("blurred by 2 px", 2.0)]
    {
        for of in [Of::All, Of::Boards, Of::Whites] {
            let expected = match of {
                Of::All if std_dev < 1.5 => Right,
                _ => Told(&["edges", "point spread", "sharp", "blur", "white images"]),
            };
            all.push(change(name, of, expected, move |image| pixels::blur(image, std_dev)));
        }
    }
    for (name, amount) in
        [("sharpened by 0.5", 0.5), ("sharpened by 1", 1.0), ("sharpened by 2", 2.0)]
    {
        for of in [Of::All, Of::Boards, Of::Whites] {
            // A little of it in boards alone moves d by 0.4 %.
            let expected = if amount < 1.0 && of == Of::Boards {
                Right
            } else {
                Warned(&["sharp", "edges", "|m|"])
            };
            all.push(change(name, of, expected, move |image| pixels::sharpened(image, amount)));
        }
    }
    all.push(change("denoised", Of::All, Right, |image| pixels::blur(image, 0.4)));
    all.push(change("denoised", Of::Boards, Right, |image| pixels::blur(image, 0.4)));
    for length in [2, 3, 6] {
        all.push(change(
            &format!("moved by {length} px"),
            Of::Boards,
            Told(&["moved", "blur", "edges", "no frame shows the board"]),
            move |image| pixels::motion(image, length),
        ));
        all.push(change(&format!("moved by {length} px"), Of::OneBoard, Right, move |image| {
            pixels::motion(image, length)
        }));
    }
    all
}

fn placed() -> Vec<Mistake> {
    let mut all = Vec::new();
    for by in [0.3, 1.0, 3.0, 8.0] {
        let named = Told(&["centre", "moved", "shift", "white images"]);
        all.push(change(&format!("shifted by {by} px"), Of::Whites, named, move |image| {
            pixels::shifted(image, by)
        }));
        let left_out = Told(&["centre", "moved", "shift", "left out"]);
        all.push(change(&format!("shifted by {by} px"), Of::OneBoard, left_out, move |image| {
            pixels::shifted(image, by)
        }));
    }
    for degrees in [0.05, 0.5, 5.0] {
        all.push(change(
            &format!("turned by {degrees} degrees"),
            Of::Boards,
            Told(&["centre", "rotated", "corners"]),
            move |image| pixels::turned(image, degrees),
        ));
    }
    for (name, u, v) in [
        ("pixels 0.3 % wider", 1.003, 1.0),
        ("pixels 1 % wider", 1.01, 1.0),
        ("pixels 3 % wider", 1.03, 1.0),
    ] {
        all.push(change(name, Of::All, Told(&["pixels", "square", "stretched"]), move |image| {
            pixels::enlarged(image, u, v)
        }));
    }
    for by in [1.002, 1.02, 0.98] {
        all.push(change(
            &format!("enlarged by {by}"),
            Of::Boards,
            Told(&["centre", "scale", "corners", "resized", "another size"]),
            move |image| pixels::enlarged(image, by, by),
        ));
        all.push(change(
            &format!("enlarged by {by}"),
            Of::All,
            if (by - 1.0_f64).abs() < 0.01 {
                Right
            } else {
                Warned(&["pixel_size_mm", "square_mm", "pixel"])
            },
            move |image| pixels::enlarged(image, by, by),
        ));
    }
    all
}

/// Another number of pixels, or another side up.
fn resized() -> Vec<Mistake> {
    let mut all = Vec::new();
    let half = |image: image::GrayImage| {
        imageops::resize(&image, image.width() / 2, image.height() / 2, imageops::Triangle)
    };
    all.push(mistake("half size, as stated", Refused(&["width_px", "500"]), move || {
        changed(Set::mini(), Of::All, |_, image| half(image).into())
    }));
    all.push(mistake(
        "half size, with its number of pixels",
        Warned(&["pixel_size_mm", "pixel"]),
        move || {
            let set = changed(Set::mini(), Of::All, |_, image| half(image).into());
            set.value("width_px", "500").value("height_px", "375")
        },
    ));
    all.push(mistake("half size, with its pixels", Right, move || {
        let set = changed(Set::mini(), Of::All, |_, image| half(image).into());
        set.value("width_px", "500").value("height_px", "375").value("pixel_size_mm", "0.011")
    }));
    all.push(mistake("cut to 900 x 700 px", Right, || {
        let set = changed(Set::mini(), Of::All, |_, image| {
            imageops::crop_imm(&image, 50, 25, 900, 700).to_image().into()
        });
        set.value("width_px", "900").value("height_px", "700")
    }));
    for (name, of) in [("mirrored", Of::All), ("mirrored", Of::Boards), ("mirrored", Of::Whites)] {
        let expected =
            if of == Of::All { Right } else { Told(&["centre", "corners", "mirrored", "rotated"]) };
        all.push(change(name, of, expected, imageops::flip_horizontal));
    }
    all.push(change("upside down", Of::All, Right, imageops::rotate180));
    all.push(change(
        "upside down",
        Of::OneBoard,
        Warned(&["frame 4", "calibration-04"]),
        imageops::rotate180,
    ));
    all.push(change(
        "mirrored",
        Of::OneBoard,
        Warned(&["frame 4", "calibration-04"]),
        imageops::flip_horizontal,
    ));
    all
}

fn marred() -> Vec<Mistake> {
    let mut all = Vec::new();
    for std_dev in [1.0, 3.0, 8.0, 20.0] {
        let expected = if std_dev < 10.0 { Right } else { Told(&["noise", "dark", "corners"]) };
        all.push(change(
            &format!("noise of {std_dev} grey levels"),
            Of::All,
            expected,
            move |image| pixels::noise(image, std_dev),
        ));
        all.push(change(
            &format!("noise of {std_dev} grey levels"),
            Of::Boards,
            expected,
            move |image| pixels::noise(image, std_dev),
        ));
    }
    for part in [1e-4, 1e-3, 0.01, 0.05] {
        let expected = if part < 0.02 { Right } else { Told(&["have no edge"]) };
        all.push(change(
            &format!("{part} of all pixels faulty"),
            Of::All,
            expected,
            move |image| pixels::salt_and_pepper(image, part),
        ));
        all.push(change(
            &format!("{part} of all pixels faulty"),
            Of::Boards,
            Right,
            move |image| pixels::salt_and_pepper(image, part),
        ));
    }
    for (name, left, right) in
        [("light from 1 to 0.7", 1.0, 0.7), ("light from 1 to 0.3", 1.0, 0.3)]
    {
        for of in [Of::Boards, Of::Whites, Of::All] {
            all.push(change(name, of, Right, move |image| pixels::uneven(image, left, right)));
        }
    }
    for (name, area) in [
        ("a fifth covered", [400, 0, 200, 750]),
        ("a corner covered", [0, 0, 250, 200]),
        ("half covered", [0, 0, 500, 750]),
    ] {
        for of in [Of::Boards, Of::Whites, Of::OneBoard] {
            all.push(change(name, of, Right, move |image| pixels::covered(image, area, 3)));
        }
    }
    all.push(change("a white label in it", Of::Boards, Right, |image| {
        pixels::covered(image, [600, 600, 200, 40], 255)
    }));
    all.push(change("a white label in it", Of::Whites, Right, |image| {
        pixels::covered(image, [600, 600, 200, 40], 255)
    }));
    all
}

fn formats() -> Vec<Mistake> {
    let sixteen = |scale: f64, most: f64| {
        move |_: usize, image: image::GrayImage| -> DynamicImage {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // bounded
            let of = |x: u8| (f64::from(x) * scale).min(most) as u16;
            ImageBuffer::from_fn(image.width(), image.height(), |u, v| {
                Luma([of(image.get_pixel(u, v).0[0])])
            })
            .into()
        }
    };
    let written = |name: &str, expected, of: Of, change: fn(image::GrayImage) -> DynamicImage| {
        mistake(format!("{name}, {}", of.name()), expected, move || {
            changed(Set::mini(), of, |_, image| change(image))
        })
    };
    vec![
        mistake("12 bits in 16", Right, move || {
            changed(Set::mini(), Of::All, sixteen(16.06, 4095.0))
        }),
        mistake("12 bits in 16, clipped at 2500", Right, move || {
            changed(Set::mini(), Of::All, sixteen(16.06, 2500.0))
        }),
        mistake("16 bits", Right, move || changed(Set::mini(), Of::All, sixteen(257.0, 65535.0))),
        mistake("boards of 16 bits, whites of 8", Right, move || {
            changed(Set::mini(), Of::Boards, sixteen(257.0, 65535.0))
        }),
        mistake("boards of 12 bits in 16, whites of 8", Right, move || {
            changed(Set::mini(), Of::Boards, sixteen(16.06, 4095.0))
        }),
        mistake(
            "16 bits with swapped bytes",
            Refused(&["white", "noise", "dark", "lattice"]),
            || {
                changed(Set::mini(), Of::All, |_, image| {
                    ImageBuffer::from_fn(image.width(), image.height(), |u, v| {
                        Luma([(u16::from(image.get_pixel(u, v).0[0]) * 257 / 5).swap_bytes()])
                    })
                    .into()
                })
            },
        ),
        written("written as colours", Right, Of::All, |image| {
            DynamicImage::ImageLuma8(image).to_rgb8().into()
        }),
        written("written with alpha", Right, Of::All, |image| {
            DynamicImage::ImageLuma8(image).to_rgba8().into()
        }),
        written("written as colours", Right, Of::Boards, |image| {
            DynamicImage::ImageLuma8(image).to_rgb8().into()
        }),
        mistake("grey images as a mosaic", Right, || Set::mini().value("color", "\"bayer-rggb\"")),
        mistake("grey images as another mosaic", Right, || {
            Set::mini().value("color", "\"bayer-gbrg\"")
        }),
        mistake("a mosaic as grey", Right, || {
            Set::of(&["--set", "imaging.color=bayer-rggb"]).value("color", "\"grey\"")
        }),
        mistake("a mosaic with its colours swapped", Right, || {
            Set::of(&["--set", "imaging.color=bayer-rggb"]).value("color", "\"bayer-bggr\"")
        }),
    ]
}

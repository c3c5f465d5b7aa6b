//! Prints where Rust sources can be changed in one place: a line of JSON each, `[file, first byte, end, text instead]`.

use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Expr, ImplItem, Item, Lit, Stmt, UnOp};

fn main() {
    for file in std::env::args().skip(1) {
        let text = std::fs::read_to_string(&file).expect("a source");
        let tree = syn::parse_file(&text).expect("code that compiles");
        Places { file, text }.visit_file(&tree);
    }
}

struct Places {
    file: String,
    text: String,
}

impl Places {
    fn text(&self, part: &impl Spanned) -> &str {
        &self.text[part.span().byte_range()]
    }

    /// A place: `whole`, with `instead` for `part` of it.
    fn swap(&self, whole: &Expr, part: &impl Spanned, instead: &str) {
        let (whole, part) = (whole.span().byte_range(), part.span().byte_range());
        let before = &self.text[whole.start..part.start];
        let after = &self.text[part.end..whole.end];
        let instead = format!("{before}{instead}{after}");
        let row = serde_json::json!([self.file, whole.start, whole.end, instead]);
        println!("{row}");
    }
}

/// Whether this is compiled for tests only, or not with the default features.
fn left_out(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        syn::Meta::List(list) if list.path.is_ident("cfg") => {
            let when = list.tokens.to_string();
            when.contains("test") || when.contains("not")
        }
        _ => false,
    })
}

/// Each becomes its neighbour: the first the second and the other way round.
const OPERATORS: [&str; 16] = [
    "<", "<=", ">", ">=", "==", "!=", "&&", "||", "+", "-", "*", "/", "+=", "-=", "*=", "/=",
];

/// Whether a condition has a `let` in it, and is therefore no value.
fn binds(condition: &Expr) -> bool {
    match condition {
        Expr::Let(_) => true,
        Expr::Binary(both) => binds(&both.left) || binds(&both.right),
        _ => false,
    }
}

fn only_leaves(block: &syn::Block) -> bool {
    let leave = |e: &Expr| matches!(e, Expr::Return(_) | Expr::Continue(_) | Expr::Break(_));
    matches!(block.stmts.as_slice(), [Stmt::Expr(only, _)] if leave(only))
}

impl<'ast> Visit<'ast> for Places {
    fn visit_expr(&mut self, expr: &'ast Expr) {
        match expr {
            Expr::Binary(both) if !binds(expr) => {
                if let Some(place) = OPERATORS.iter().position(|o| *o == self.text(&both.op)) {
                    self.swap(expr, &both.op, OPERATORS[place ^ 1]);
                }
            }
            Expr::Unary(unary) if !matches!(unary.op, UnOp::Deref(_)) => {
                self.swap(expr, &unary.op, "");
            }
            Expr::MethodCall(call) if call.method == "min" => self.swap(expr, &call.method, "max"),
            Expr::MethodCall(call) if call.method == "max" => self.swap(expr, &call.method, "min"),
            Expr::Lit(lit) => {
                if let Lit::Float(number) = &lit.lit
                    && number.base10_parse::<f64>().is_ok_and(|n| n != 0.0)
                {
                    self.swap(expr, expr, &format!("({} * 1.5)", self.text(expr)));
                }
            }
            Expr::Index(index) => {
                if let Expr::Binary(both) = &*index.index
                    && [self.text(&both.op), self.text(&both.right)] == ["+", "1"]
                {
                    self.swap(&index.index, &index.index, self.text(&both.left));
                }
            }
            Expr::If(branch) if only_leaves(&branch.then_branch) && !binds(&branch.cond) => {
                let instead = format!("!({})", self.text(&branch.cond));
                self.swap(&branch.cond, &branch.cond, &instead);
            }
            // Lengths and constants are the compiler's.
            Expr::Repeat(repeat) => return self.visit_expr(&repeat.expr),
            Expr::Const(_) => return,
            _ => {}
        }
        visit::visit_expr(self, expr);
    }

    fn visit_item(&mut self, item: &'ast Item) {
        let of = |item: &syn::ItemImpl| item.trait_.as_ref()?.1.segments.last().cloned();
        let ours = match item {
            Item::Mod(item) => !left_out(&item.attrs),
            Item::Fn(item) => !left_out(&item.attrs) && item.sig.constness.is_none(),
            // Words are not what is measured here.
            Item::Impl(item) => {
                let words = of(item).is_some_and(|of| of.ident == "Display" || of.ident == "Debug");
                !left_out(&item.attrs) && !words
            }
            item => matches!(item, Item::Trait(_)),
        };
        if ours {
            visit::visit_item(self, item);
        }
    }

    fn visit_impl_item(&mut self, item: &'ast ImplItem) {
        if let ImplItem::Fn(item) = item
            && !left_out(&item.attrs)
            && item.sig.constness.is_none()
        {
            visit::visit_impl_item_fn(self, item);
        }
    }

    fn visit_type(&mut self, _: &'ast syn::Type) {}
    fn visit_pat(&mut self, _: &'ast syn::Pat) {}
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
    fn visit_macro(&mut self, _: &'ast syn::Macro) {}
    fn visit_generic_argument(&mut self, _: &'ast syn::GenericArgument) {}
}
